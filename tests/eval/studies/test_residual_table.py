"""The residual of a study's runs, by family, beside the paper's ranges."""

from pathlib import Path

import pytest

from dualhead_eval.gate import read_gate
from dualhead_eval.statistics.run import open_run
from dualhead_eval.studies.residual_table import residual_table
from dualhead_eval.studies.study_cells import StudyCell

RESULTS = Path(__file__).parents[3] / "results" / "v2"


def cell(name, step=20_000):
    gate = read_gate(RESULTS / f"{name}-20k.gate.json.gz")
    return StudyCell("v2", name, 20_000, step, "frozen", (), (open_run(gate),), (0,))


@pytest.fixture(scope="module")
def table():
    names = ("A_independent", "D_latent_prior", "G_consistency_3", "H_episode_token_uniform", "K_oracle")
    return residual_table([cell(name) for name in names])


def test_families_follow_the_papers_table_and_stand_beside_it(table):
    assert [row[0] for row in table.rows] == [
        "v2 uncoordinated families", "    the paper", "v2 strong consistency", "    the paper",
        "v2 episode tokens", "    the paper", "v2 window tokens and oracle", "    the paper",
    ]  # fmt: skip
    ours, theirs = table.rows[:2]
    assert ours[1] == "2"
    assert ours[2] == "14.3 to 14.8"
    assert theirs[1:] == ("10", "18.0 to 24.0", "151.4 to 159.5", "77.3 to 88.5", "3.32 to 4.68", "82.8 to 89.7")


def test_the_oracles_residual_is_all_floor(table):
    oracle = table.rows[-2]
    assert oracle[4] == oracle[2]
    assert float(oracle[-1]) < 0.1


def test_checkpoints_on_the_way_and_gates_without_residuals_are_not_read():
    assert residual_table([cell("A_independent", step=10_000)]) is None
    bare = read_gate(RESULTS.parent / "ring" / "D_latent_prior_nullspace.gate.json.gz")
    assert residual_table([StudyCell("ring", "D", 6000, 6000, "frozen", (), (open_run(bare),), (0,))]) is None
