"""A cell of a study, seeds of known coupling as if trained and evaluated; and a small study that is."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_study import command, write_study

from dualhead_eval.cli import main
from dualhead_eval.statistics.run import open_run
from dualhead_eval.studies.gate_store import StudyResult
from dualhead_eval.studies.study_cells import StudyCell

SEEDS = (0, 1, 2)


@pytest.fixture
def cell(make_gate):
    """Builds a cell of seeds of known coupling."""

    def build(
        configuration,
        couplings,
        *,
        dataset="ring",
        budget=1000,
        step=None,
        bank="frozen",
        planned=SEEDS,
        target=None,
        **gate,
    ):
        gates = [
            make_gate(f"{configuration} {dataset} {seed}", couple=abs(couple), flip=couple < 0, seed=seed,
                      conditions=30, **{"method": "policy", **gate})
            for seed, couple in enumerate(couplings)
        ]  # fmt: skip
        if target is not None:
            gates = [replace(one, target_probabilities=np.array(target)) for one in gates]
        at = budget if step is None else step
        results = tuple(
            StudyResult(dataset, configuration, budget, seed, at, bank, gate, Path()) for seed, gate in enumerate(gates)
        )
        runs = tuple(open_run(gate) for gate in gates)
        return StudyCell(dataset, configuration, budget, at, bank, results, runs, tuple(planned))

    return build


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A finished study's folder."""
    folder = tmp_path_factory.mktemp("study")
    write_study(folder)
    assert main(command(folder)) == 0
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    """A copy of a finished study's results alone: no data, no runs, as somebody else would find them."""
    shutil.copytree(finished / "results", tmp_path / "results")
    write_study(tmp_path)
    return tmp_path
