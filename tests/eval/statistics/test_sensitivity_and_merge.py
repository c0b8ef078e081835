"""Threshold and step scans, and merging gates as if everything had been evaluated together."""

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.gate.gate import Gate
from dualhead_eval.gate.merge import merge_gates
from dualhead_eval.residuals.strata import residual_strata
from dualhead_eval.statistics.run_summary import summarise_run
from dualhead_eval.statistics.sensitivity import curves, nfe_curve, ranking_is_stable, tau_curve

TAUS, NFES = [0.4, 0.55, 0.7], [5, 20]


def scanned(couple=0.5, seed=0, conditions=8, n=300, first_pair=0, label="run"):
    """Labels with a strength; raising tau invalidates the weak ones, fewer steps weaken all."""
    rng = np.random.default_rng(seed)
    a, own = rng.integers(0, 2, size=(2, conditions, n))
    b = np.where(rng.random(a.shape) < couple, a, own)
    strength = rng.beta(6, 3, size=(2, *a.shape))
    residual = rng.gamma(2, 5, size=a.shape)
    labels = [
        [[np.where(scale * s >= tau, m, -1) for m, s in zip((a, b), strength, strict=True)] for tau in TAUS]
        for scale in (0.9, 1.0)
    ]
    cut = np.array(labels)
    return Gate(
        heads=("joint", "position"),
        n_modes=2,
        taus=TAUS,
        nfes=NFES,
        reference_tau=0.55,
        reference_nfe=20,
        counts=joint_counts(cut[:, :, 0], cut[:, :, 1], 2),
        conditions=first_pair + np.arange(conditions, dtype=float)[:, None],
        pair_ids=first_pair + np.arange(conditions),
        provenance={"label": label, "partition": {"name": "ring", "n_modes": 2}, "seed": seed},
        strata={"position": residual_strata(np.broadcast_to(residual, cut[:, :, 0].shape), cut[:, :, 0], cut[:, :, 1])},
    )


def test_a_higher_threshold_costs_valid_pairs():
    curve = tau_curve(scanned(), draws=10)
    assert curve.positions == TAUS
    rates = [point.valid_rate for point in curve.points]
    assert sorted(rates, reverse=True) == rates
    assert len({point.n_pairs for point in curve.points}) == 1
    assert curve.swing == pytest.approx(np.ptp([point.rho for point in curve.points]))
    assert [point.nfe for point in nfe_curve(scanned(), draws=10).points] == NFES


def test_rankings_that_change_places_are_seen():
    weak, strong = (tau_curve(scanned(couple), draws=10) for couple in (0.1, 0.8))
    assert ranking_is_stable([weak, strong])
    crossing = replace(weak, points=(strong.points[0], *weak.points[1:]))
    flipped = replace(strong, points=(weak.points[0], *strong.points[1:]))
    assert not ranking_is_stable([crossing, flipped])
    assert len(curves([scanned(), scanned(seed=1)], "tau")) == 2
    with pytest.raises(ValueError, match="axis"):
        curves([scanned()], "seed")


def test_merging_conditions_equals_evaluating_them_together():
    one, two = scanned(conditions=5), scanned(seed=1, conditions=3, first_pair=5)
    merged = merge_gates([one, two])
    np.testing.assert_array_equal(merged.counts, np.concatenate([one.counts, two.counts], axis=2))
    assert merged.n_conditions == 8
    np.testing.assert_array_equal(
        merged.strata["position"].u, np.concatenate([one.strata["position"].u, two.strata["position"].u], 2)
    )
    summary = summarise_run(merged, draws=10)
    assert summary.n_pairs == summarise_run(one, draws=10).n_pairs + summarise_run(two, draws=10).n_pairs


def test_merging_samples_of_the_same_conditions_adds_their_counts():
    one, two = scanned(), scanned(seed=1)
    merged = merge_gates([one, two])
    np.testing.assert_array_equal(merged.counts, one.counts + two.counts)
    assert merged.n_conditions == one.n_conditions
    assert merged.strata == {}
    assert len(merged.provenance["merged_from"]) == 2


def test_gates_that_do_not_belong_together_are_refused():
    gate = scanned()
    other_partition = replace(gate, provenance=gate.provenance | {"partition": {"name": "bypass-v2", "n_modes": 2}})
    with pytest.raises(ValueError, match="partition"):
        merge_gates([gate, other_partition])
    with pytest.raises(ValueError, match="label"):
        merge_gates([gate, scanned(label="another run")])
    with pytest.raises(ValueError, match="given twice"):
        merge_gates([gate, scanned()])
    with pytest.raises(ValueError, match="target_probabilities"):
        merge_gates([gate, replace(scanned(seed=1), target_probabilities=np.array([0.5, 0.5]))])
    with pytest.raises(ValueError, match="no gate"):
        merge_gates([])
