"""A cell under other thresholds and Euler steps: its table, and whether an order of rows depends on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.statistics.run import open_run
from dualhead_eval.studies.criterion import RankingCriterion
from dualhead_eval.studies.grading.rankings import grade_ranking
from dualhead_eval.studies.operating_points import operating_points
from dualhead_eval.studies.sensitivity_table import sensitivity_table

CRITERION = RankingCriterion(
    name="n", claim="c", criterion="c", rows=["A"], test="ranking", banks=["b"], between=[0.4, 0.6], tie=0.01
)


def at_few_steps(cell, counts_of):
    """The cell with, at its smaller number of steps, the counts of another one."""
    runs = []
    for run, other in zip(cell.runs, counts_of.runs, strict=True):
        counts = run.gate.counts.copy()
        counts[0] = other.gate.counts[0]
        runs.append(open_run(replace(run.gate, counts=counts, strata={})))
    return replace(cell, runs=tuple(runs))


def test_every_threshold_at_the_reference_steps_and_the_other_steps_at_the_reference_threshold(cell):
    points = operating_points(cell("A", [0.3, 0.4, 0.5], weak=True))
    assert [(point.tau, point.nfe) for point in points] == [(0.4, 20), (0.55, 20), (0.55, 10)]
    assert points[0].mean("valid_rate") > points[1].mean("valid_rate")
    assert points[1].mean("rho") == pytest.approx(0.4, abs=0.03)


def test_the_table_has_a_line_per_point_and_the_papers_number_where_it_prints_one(cell):
    setting = {"partition": "bypass-v2", "config": {"source_noise_beta": 0.0, "consistency_weight": 3.0}}
    scanned = cell("G", [0.5] * 3, **setting)
    gates = [replace(run.gate, taus=[0.11, 0.14], nfes=[5, 20], reference_tau=0.11) for run in scanned.runs]
    scanned = replace(scanned, runs=tuple(open_run(gate) for gate in gates))
    table = sensitivity_table([scanned])
    assert [row[1:3] for row in table.rows] == [("0.11", "20"), ("0.14", "20"), ("0.11", "5")]
    assert [row[6:] for row in table.rows] == [("+0.244", "0.458"), ("+0.299", "0.255"), ("+0.291", "-")]


def test_cells_at_one_point_or_on_the_way_have_no_table(cell):
    whole = cell("A", [0.3])
    gates = [replace(run.gate, taus=[0.55], nfes=[20], counts=run.gate.counts[1:, 1:], strata={}) for run in whole.runs]
    assert sensitivity_table([replace(whole, runs=tuple(open_run(gate) for gate in gates))]) is None
    assert sensitivity_table([cell("A", [0.3], step=500)]) is None


def test_an_order_that_holds_at_every_point(cell):
    grade = grade_ranking([cell("low", [0.1] * 3), cell("high", [0.8] * 3)], CRITERION)
    assert grade.grade == "holds"
    assert grade.evidence.startswith("high > low (3 points, tau 0.4 to 0.55, 10 to 20 steps")


def test_rows_that_change_places_beyond_a_tie(cell):
    low, high = cell("low", [0.1] * 3), cell("high", [0.8] * 3)
    turned = at_few_steps(high, counts_of=cell("none", [-0.4] * 3))
    assert grade_ranking([low, turned], CRITERION).grade == "does not hold"
    elsewhere = CRITERION.model_copy(update={"between": [0.4, 0.5]})
    assert grade_ranking([low, turned], elsewhere).grade == "not graded"  # one point is left


def test_rows_alike_are_no_order_to_lose(cell):
    same = cell("A", [0.3] * 3)
    assert grade_ranking([same, replace(same, configuration="B")], CRITERION).grade == "holds"


def test_one_row_alone_has_no_order(cell):
    assert grade_ranking([cell("A", [0.3] * 3)], CRITERION).grade == "not graded"
    assert np.isfinite(operating_points(cell("A", [0.3]))[0].mean("delta"))
