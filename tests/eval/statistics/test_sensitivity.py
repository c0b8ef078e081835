"""Scans of the threshold and of the integration steps."""

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.statistics.sensitivity import curves, nfe_curve, ranking_is_stable, tau_curve


def test_a_higher_threshold_costs_valid_pairs(make_gate):
    gate = make_gate(couple=0.5, weak=True)
    curve = tau_curve(gate, draws=10)
    assert curve.positions == gate.taus
    rates = [point.valid_rate for point in curve.points]
    assert rates[0] > rates[1]
    assert len({point.n_pairs for point in curve.points}) == 1
    assert curve.swing == pytest.approx(np.ptp([point.rho for point in curve.points]))


def test_a_curve_holds_the_other_axis_at_the_point_asked_for(make_gate):
    gate = make_gate()
    assert {point.nfe for point in tau_curve(gate, draws=10).points} == {gate.reference_nfe}
    assert {point.nfe for point in tau_curve(gate, nfe=10, draws=10).points} == {10}
    assert [point.nfe for point in nfe_curve(gate, draws=10).points] == gate.nfes
    assert {point.tau for point in nfe_curve(gate, tau=0.4, draws=10).points} == {0.4}


def test_rankings_that_change_places_are_seen(make_gate):
    weak, strong = (tau_curve(make_gate(couple=couple), draws=10) for couple in (0.1, 0.8))
    assert ranking_is_stable([weak, strong])
    crossing = replace(weak, points=(strong.points[0], *weak.points[1:]))
    flipped = replace(strong, points=(weak.points[0], *strong.points[1:]))
    assert not ranking_is_stable([crossing, flipped])


def test_only_gates_that_scanned_an_axis_have_a_curve(make_gate):
    gate = make_gate()
    single = replace(gate, taus=[0.55], counts=gate.counts[:, 1:], strata={})
    assert len(curves([gate, make_gate(seed=1), single], "tau")) == 2
    with pytest.raises(ValueError, match="axis"):
        curves([gate], "seed")
