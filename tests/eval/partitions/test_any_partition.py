"""Partitions of one's own: what the command line may name, and what their answers must be."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from dualhead_eval.partitions.opening import open_partition
from dualhead_eval.partitions.scored import ScoredPartition
from dualhead_eval.partitions.side import SidePartition

PATHS = np.random.default_rng(0).normal(size=(5, 4, 6, 2))
NO_CONDITION = np.zeros((5, 1, 0))


class Assigned:
    """The least that a partition must have."""

    n_modes, tau = 2, 0.0

    def assign(self, path, condition, tau=None):
        return (path[..., -1, 0] > 0).astype(int)

    def to_dict(self):
        return {"name": "assigned"}


def changed(**changes):
    return type("Changed", (Assigned,), changes)()


def test_what_only_assigns_is_counted_at_its_own_threshold():
    partition = ScoredPartition(Assigned())
    label, strength = partition.score(PATHS, NO_CONDITION)
    assert (label == (PATHS[..., -1, 0] > 0)).all()
    assert np.isposinf(strength).all()
    assert partition.to_dict() == {"name": "assigned", "n_modes": 2, "tau": 0.0}
    assert not partition.has_score
    assert ScoredPartition(SidePartition([0, 1], tau=1)).has_score


@pytest.mark.parametrize(
    ("partition", "sentence"),
    [
        (object(), "lacks 'assign'"),
        (changed(n_modes=1), "n_modes=1"),
        (changed(n_modes=2.0), "n_modes=2.0"),
        (changed(tau=float("nan")), "tau=nan"),
        (changed(to_dict=lambda self: {"name": object()}), "not plain JSON"),
        (changed(to_dict=lambda self: {"name": "ring"}), "is taken"),
        (changed(to_dict=lambda self: {"name": "x", "n_modes": 3}), "make them the same"),
        (changed(to_dict=lambda self: []), "has the name"),
    ],
)
def test_what_is_no_partition_is_refused(partition, sentence):
    with pytest.raises(ValueError, match=sentence):
        ScoredPartition(partition)


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (lambda path: path[..., 0, 0] > 0, "dtype bool"),
        (lambda path: np.full(path.shape[:-2], 2), "label 2 is outside"),
        (lambda path: np.zeros(3, dtype=int), "vectorise"),
        (lambda path: np.full(path.shape[:-2], 0.5), "fractions"),
        (lambda path: np.full(path.shape[:-2], np.nan), "NaN"),
    ],
)
def test_answers_that_are_no_labels_are_refused(answer, sentence):
    partition = changed(assign=lambda self, path, condition, tau=None: answer(path))
    with pytest.raises(ValueError, match=sentence):
        ScoredPartition(partition).score(PATHS, NO_CONDITION)


def test_the_command_line_names_a_file_a_clustering_or_code_in_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = SidePartition([0, 1], tau=0.5)
    (tmp_path / "side.json").write_text(json.dumps(own.to_dict()))
    (tmp_path / "task_of_mine.py").write_text(
        "from dualhead_eval.partitions.side import SidePartition\n"
        "made = SidePartition([0, 1], tau=0.5)\n"
        "def make():\n    return made\n"
    )
    before = list(sys.path)
    try:
        for spec in ("side.json", "task_of_mine:made", "task_of_mine:make"):
            partition = open_partition(spec, PATHS)
            assert (partition.assign(PATHS, NO_CONDITION) == own.assign(PATHS)).all()
            assert partition.to_dict() == own.to_dict()
    finally:
        sys.modules.pop("task_of_mine", None)
    assert sys.path == before
    assert open_partition("endpoint:3", PATHS).n_modes == 3


@pytest.mark.parametrize(
    ("spec", "sentence"),
    [
        ("nowhere.json", "does not exist"),
        ("side", "none of the forms"),
        ("os:system('x')", "none of the forms"),
        ("no_such_module_of_mine:x", "ModuleNotFoundError"),
        ("math:pi", "gives no partition"),
        ("endpoint:1", "at least 2"),
        ("endpoint:999", "999 modes asked of 20"),
    ],
)
def test_what_names_no_partition_is_one_sentence(spec, sentence):
    with pytest.raises((ValueError, FileNotFoundError), match=sentence) as error:
        open_partition(spec, PATHS)
    assert "\n" not in str(error.value)
