"""A report is computed once, at one operating point, and says in words what the counts say."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.report.content import make_report, report_json
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.seeds import benjamini_hochberg


def test_each_site_is_named(make_gate):
    report = make_report(
        [
            make_gate("independent", 0.0),
            make_gate("half", 0.7),
            make_gate("token", 1.0),
            make_gate("one mode", 1.0, prior=[1.0, 0.0]),
        ]
    )
    readings = [run.first.reading for run in report.runs]
    assert readings[0].startswith("uncoordinated within ±")
    assert readings[1:] == [
        "coordinated in part (III)",
        "coordinated in full (IV)",
        "collapsed: a head chose one mode in every condition",
    ]


def test_under_trained_ring_runs_are_flagged_and_robots_are_not(make_gate):
    ring, robot = make_report(
        [make_gate("ring", 0.5, valid=0.8), make_gate("robot", 0.5, valid=0.8, partition="bypass-v2")]
    ).pairs
    assert ring.reading == "low-validity: valid-pair rate below 0.95"
    assert robot.readable


def test_a_wide_interval_around_zero_is_unclear_rather_than_a_class(make_gate):
    (pair,) = make_report([make_gate()]).pairs
    wide = {"rho": Interval(-0.08, 0.02, 0.95)}
    assert replace(pair, rho=-0.03, occupancy=Occupancy.NEGATIVE, intervals=wide).reading.startswith("unclear")


def test_the_operating_point_reaches_everything(make_gate):
    gate = make_gate(heads=3, weak=True, partition="bypass-v2")
    reference, strict = make_report([gate]), make_report([gate], tau=0.4, nfe=10)
    (run,) = strict.runs
    assert {(pair.tau, pair.nfe) for pair in run.pairs} == {(0.4, 10)}
    assert run.first.valid_rate > reference.runs[0].first.valid_rate
    assert run.agreement.valid_rate > reference.runs[0].agreement.valid_rate
    assert run.residuals["position"].mean != reference.runs[0].residuals["position"].mean
    assert {point.nfe for curve in strict.tau_curves for point in curve.points} == {10}
    assert {point.tau for curve in strict.nfe_curves for point in curve.points} == {0.4}
    with pytest.raises(KeyError, match="was not evaluated"):
        make_report([gate], nfe=7)


def test_what_exists_at_the_reference_point_alone_says_so(make_gate):
    gate = make_gate(partition="bypass-v2")
    assert make_report([gate]).sites
    assert make_report([gate]).reference_only == ""
    elsewhere = make_report([gate], tau=0.4)
    assert elsewhere.sites == elsewhere.comparisons == ()
    assert "hold at the reference point alone (tau 0.55, 20 steps)" in elsewhere.reference_only


def test_no_two_runs_have_one_name(make_gate):
    seeds = [make_gate("run", 0.5, seed=seed, config={"seed": seed}) for seed in range(2)]
    assert [run.name for run in make_report(seeds).runs] == ["run #1", "run #2"]


def test_environments_are_named_where_there_are_several(make_gate):
    report = make_report([make_gate("A", partition="bypass-v2"), make_gate("A", partition="rotating-v3")])
    assert [run.name for run in report.runs] == ["v2 A", "v3 A"]
    assert [run.label for run in report.runs] == ["A", "A"]


def test_head_pairs_are_named_where_there_are_several(make_gate):
    report = make_report([make_gate("two"), make_gate("three", 0.5, heads=3)])
    assert [pair.name for pair in report.pairs] == [
        "two (joint-position)",
        "three (joint-position)",
        "three (joint-rotation)",
        "three (position-rotation)",
    ]


def test_three_heads_make_three_pairs(make_gate):
    report = make_report([make_gate("pose", 0.5, heads=3)])
    assert [pair.heads for pair in report.pairs] == [
        ("joint", "position"),
        ("joint", "rotation"),
        ("position", "rotation"),
    ]


def test_p_values_are_adjusted_over_all_runs_of_a_report(make_gate):
    gates = [make_gate("a", 0.0), make_gate("b", 0.1), make_gate("one mode", 1.0, prior=[1.0, 0.0])]
    pairs = make_report(gates).pairs
    expected = benjamini_hochberg([pair.p_value for pair in pairs[:2]])
    assert [pair.adjusted_p_value for pair in pairs[:2]] == pytest.approx(expected)
    assert np.isnan(pairs[2].adjusted_p_value)


def test_a_p_value_below_what_the_replicates_resolve_is_a_bound(make_gate):
    independent, coupled = make_report([make_gate("a", 0.0), make_gate("b", 0.5)]).pairs
    assert (independent.p_value_is_bound, coupled.p_value_is_bound) == (False, True)


def test_contradictions_are_those_of_the_rows_that_the_runs_touch(make_gate):
    token = make_gate("H", 1.0, partition="bypass-v2", config={"token": "episode"})
    assert {row for row, _ in make_report([token]).contradictions} == {"v2/H episode token uniform"}
    skewed = make_gate("E", 1.0, prior=[0.92, 0.08], config={"latent": "posterior", "kl_weight": 0.01})
    skewed = replace(skewed, target_probabilities=np.array([0.92, 0.08]))
    assert {row for row, _ in make_report([skewed]).contradictions} == {"testbed skew/posterior kl0.01/p0.92"}


def test_undefined_numbers_are_null_in_json(make_gate):
    report = make_report([make_gate("one mode", 1.0, prior=[1.0, 0.0])])
    (entry,) = json.loads(json.dumps(report_json(report), allow_nan=False))
    assert entry["rho"] is None
    assert entry["intervals"]["rho"]["low"] is None
    assert "single mode" in entry["reason"]


def test_the_core_imports_neither_torch_nor_matplotlib():
    code = (
        "import sys, dualhead_eval.effects.contingency, dualhead_eval.gate, dualhead_eval.statistics.run_summary, "
        "dualhead_eval.commands.report\n"
        "sys.exit(str([m for m in ('torch', 'lerobot', 'matplotlib', 'gymnasium', 'rich') if m in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "[]"
