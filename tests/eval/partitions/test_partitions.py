"""Partitions that need no code: which way a path goes, whatever the axes in front of it and wherever its space lies."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualhead_envs.bypass.partition import BimodalPartition
from dualhead_eval.partitions.crossing import CrossingPartition
from dualhead_eval.partitions.nearest import EndpointPartition, ReferencePartition
from dualhead_eval.partitions.partition import Partition
from dualhead_eval.partitions.partition_file import build_partition, read_partition
from dualhead_eval.partitions.side import SidePartition


def partitions(rng, d, shift):
    """One of every kind in d dimensions, built from the same numbers and moved by ``shift`` (d,)."""
    normal, across = rng.normal(size=(2, d))
    references = rng.normal(size=(3, 5, d))
    return [
        SidePartition(normal, shift, tau=0.5),
        CrossingPartition(normal, across, shift, [-0.3, 0.4], tau=0.1),
        ReferencePartition(references + shift, tau=0.1),
        EndpointPartition(references[:, -1] + shift, tau=0.1),
    ]


KINDS = range(4)
seeds = st.integers(0, 10**6)


@settings(deadline=None, max_examples=20)
@given(seed=seeds, d=st.integers(2, 4), kind=st.sampled_from(KINDS))
def test_leading_axes_are_loops(seed, d, kind):
    rng = np.random.default_rng(seed)
    partition = partitions(rng, d, np.zeros(d))[kind]
    paths = rng.normal(size=(2, 3, 6, d))
    together = partition.assign(paths, np.zeros((2, 1, 7)))
    assert together.shape == (2, 3)
    assert together.dtype == np.int64
    assert [[int(partition.assign(path)) for path in row] for row in paths] == together.tolist()
    assert partition.assign(paths[0, 0], np.zeros((4, 7))).tolist() == [together[0, 0]] * 4


@settings(deadline=None, max_examples=20)
@given(seed=seeds, d=st.integers(2, 4), kind=st.sampled_from(KINDS))
def test_where_the_space_lies_does_not_matter(seed, d, kind):
    shift = np.random.default_rng(seed + 1).normal(size=d) * 5
    paths = np.random.default_rng(seed + 2).normal(size=(20, 6, d))
    here = partitions(np.random.default_rng(seed), d, np.zeros(d))[kind].score(paths)
    there = partitions(np.random.default_rng(seed), d, shift)[kind].score(paths + shift)
    clear = here[1] > 1e-6  # at a boundary rounding decides
    assert (here[0][clear] == there[0][clear]).all()
    assert there[1][clear] == pytest.approx(here[1][clear], abs=1e-9)


@settings(deadline=None, max_examples=20)
@given(seed=seeds, kind=st.sampled_from(KINDS), taus=st.tuples(st.floats(0.01, 1), st.floats(0.01, 1)))
def test_a_higher_threshold_only_invalidates(seed, kind, taus):
    rng = np.random.default_rng(seed)
    partition, paths = partitions(rng, 2, np.zeros(2))[kind], rng.normal(size=(40, 6, 2))
    low, high = (partition.assign(paths, (), tau) for tau in sorted(taus))
    assert ((high == low) | (high == -1)).all()
    assert set(low.tolist()) <= set(range(-1, partition.n_modes))


@settings(deadline=None, max_examples=20)
@given(seed=seeds, kind=st.sampled_from(KINDS))
def test_its_description_builds_it_again(seed, kind):
    rng = np.random.default_rng(seed)
    partition = partitions(rng, 3, np.zeros(3))[kind]
    again = build_partition(json.loads(json.dumps(partition.to_dict())))
    assert isinstance(again, Partition)
    assert (again.n_modes, again.tau) == (partition.n_modes, partition.tau)
    paths = rng.normal(size=(20, 6, 3))
    label, strength = partition.score(paths)
    built_label, built_strength = again.score(paths)
    clear = strength > 1e-6
    assert (built_label[clear] == label[clear]).all()
    assert built_strength[clear] == pytest.approx(strength[clear])


def test_a_side_is_the_rule_of_the_bypass():
    paths = np.random.default_rng(0).normal(size=(200, 16, 3)) * 0.1
    condition = np.zeros((200, 5))
    ours = BimodalPartition().assign(paths, condition)
    assert (SidePartition([0, 2, 0], tau=BimodalPartition().tau).assign(paths, condition) == ours).all()
    assert set(ours.tolist()) == {-1, 0, 1}


def test_the_first_crossing_decides_in_both_directions_and_none_is_invalid():
    doors = CrossingPartition([1, 0], [0, 1], boundaries=[0.0], tau=0.1)
    there_and_back = [[-1, -1], [1, -1], [1, 5], [-1, 5]]
    assert doors.assign([there_and_back, there_and_back[::-1]]).tolist() == [0, 1]
    assert doors.assign([[[-1, 2], [-0.5, 3]]]).tolist() == [-1]
    assert doors.assign([[[-1, 2]]]).tolist() == [-1]


def test_references_name_modes_and_swap_with_them():
    rng = np.random.default_rng(0)
    references, order = rng.normal(size=(3, 5, 2)), np.array([2, 0, 1])
    paths = references[:, None] + 0.1 * rng.normal(size=(3, 10, 5, 2))
    label = ReferencePartition(references).assign(paths)
    assert (label == np.arange(3)[:, None]).all()
    assert (order[ReferencePartition(references[order]).assign(paths)] == label).all()
    # Only the way counts, not the number of steps.
    halfway = (paths[:, :, 1:] + paths[:, :, :-1]) / 2
    finer = np.stack([paths[:, :, :-1], halfway], axis=3).reshape(3, 10, 8, 2)
    assert (ReferencePartition(references).assign(np.concatenate([finer, paths[:, :, -1:]], axis=2)) == label).all()


def test_clusters_of_end_points_are_found_in_a_fixed_order():
    rng = np.random.default_rng(0)
    goals = np.array([[0.0, 3.0], [-2.0, 0.0], [2.0, 0.0]])
    paths = np.concatenate(
        [rng.normal(size=(3, 50, 4, 2)), goals[:, None, None] + rng.normal(size=(3, 50, 1, 2)) * 0.1], 2
    )
    fitted = EndpointPartition.fit(paths, 3, seed=0)
    assert fitted.centers == pytest.approx(goals[[1, 0, 2]], abs=0.1)
    assert (fitted.assign(paths) == np.array([1, 0, 2])[:, None]).all()
    with pytest.raises(ValueError, match="3 modes asked of 2"):
        EndpointPartition.fit(np.arange(4.0).reshape(2, 1, 2), 3, seed=0)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: SidePartition([0, 0], tau=1), "expected a direction"),
        (lambda: SidePartition([0, np.nan], tau=1), "NaN"),
        (lambda: SidePartition([0, 1], [0, 0, 0], tau=1), "expected 2"),
        (lambda: SidePartition([0, 1], tau=0), "positive number"),
        (lambda: SidePartition([0, 1], tau=1).assign(np.zeros((4, 3))), r"expected \(..., H, 2\)"),
        (lambda: SidePartition([0, 1], tau=1).assign(np.full((4, 2), np.nan)), "NaN"),
        (lambda: SidePartition([0, 1], tau=1).assign(np.zeros((4, 2)), (), -1), "positive number"),
        (lambda: CrossingPartition([0, 1], [0, -2], tau=1), "directions of one space that differ"),
        (lambda: CrossingPartition([0, 1], [1, 0], boundaries=[1, 0], tau=1), "increasing"),
        (lambda: ReferencePartition(np.zeros((2, 3, 2))), "all differ"),
        (lambda: EndpointPartition([[0.0, 1.0]]), "two or more"),
    ],
)
def test_what_makes_no_partition_is_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ('{"name": "side", "tau": 1, "parameters": {"normal": [0, 0]}}', "expected a direction"),
        ('{"name": "side", "tau": 1}', "lacks the field"),
        ('{"name": "os.system", "tau": 1, "parameters": {}}', "os.system"),
        ('{"name": "side", "tau": 1, "n_modes": 3, "parameters": {"normal": [0, 1]}}', "its parameters make 2"),
        ('{"name": "side", "tau": NaN, "parameters": {"normal": [0, 1]}}', "NaN"),
        ('{"name": "reference", "tau": 1, "parameters": {"references": [[[0], [1]], [[0, 1], [1]]]}}', "describes no"),
        ("[]", "expected"),
        ("side", "not JSON"),
    ],
)
def test_a_file_that_describes_none_is_one_sentence(content, sentence, tmp_path):
    (tmp_path / "p.json").write_text(content)
    with pytest.raises(ValueError, match=sentence) as error:
        read_partition(tmp_path / "p.json")
    assert "p.json" in str(error.value)
    assert "\n" not in str(error.value)
