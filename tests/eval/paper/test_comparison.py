"""Our numbers stand beside the paper's where both have the same setting and operating point."""

import pytest

from dualhead_eval.paper.comparison import compare_with_paper
from dualhead_eval.paper.sites import compare_sites
from dualhead_eval.statistics.run import open_run

POLAR_NOISE = {"source_noise_beta": 0.0, "representation": {"kinematic_map": "ring/polar"}}


def test_a_testbed_run_is_compared_with_its_maps_row(make_gate):
    (rho,) = compare_with_paper([open_run(make_gate("polar noise", 0.67, config=POLAR_NOISE))])
    assert (rho.quantity, rho.paper, rho.source) == ("rho", 0.678, "tab:maps")
    assert rho.difference == rho.ours - 0.678
    assert rho.ours in rho.interval


def test_head_valid_marginals_stand_beside_the_rows_that_the_paper_computed_so(make_gate):
    robot = open_run(make_gate("A", partition="bypass-v2"))
    comparisons = {c.quantity: c for c in compare_with_paper([robot])}
    assert comparisons["capacity"].head_valid == pytest.approx(0.5, abs=0.01)
    assert comparisons["obs"].head_valid is None
    assert comparisons["valid_rate"].paper == 0.7729
    assert comparisons["residual_mm"].paper == 84.79
    exact = open_run(make_gate("H", partition="bypass-v2", config={"token": "episode"}))
    assert all(c.head_valid is None for c in compare_with_paper([exact]))


def test_a_run_without_a_row_is_not_compared(make_gate):
    run = open_run(make_gate(partition="none"))
    assert compare_with_paper([run]) == compare_sites([run]) == []


def test_numbers_at_another_threshold_are_not_put_beside_the_papers(make_gate):
    assert compare_with_paper([open_run(make_gate("polar noise", 0.67, config=POLAR_NOISE), tau=0.4)]) == []
