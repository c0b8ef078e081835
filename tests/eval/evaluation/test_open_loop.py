"""Open-loop evaluation: golden counts of the exact reference, and a protocol whose parts do not touch each other."""

from __future__ import annotations

import numpy as np
import pytest

from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.evaluation.open_loop import evaluate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import open_exact_reference
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_policy.sampling import SamplingCoupling


@pytest.fixture(scope="module")
def conditions(ring_data):
    return open_conditions(ring_data / "test")


# `dualhead evaluate --exact` on this bank before there was one evaluation call: counts over all conditions at tau 0.55,
# rows the joint head's mode, columns the position head's, and the mean residual in mm at 20 steps.
GOLDEN = {
    1.0: {20: [[194, 188], [214, 172]], 5: [[191, 180], [199, 198]], "residual": 689.7498258572377},
    0.0: {20: [[141, 241], [231, 155]], 5: [[137, 234], [247, 150]], "residual": 804.9397506501604},
}


@pytest.mark.parametrize("beta", [1.0, 0.0])
def test_the_exact_reference_keeps_its_golden_counts(conditions, beta):
    protocol = EvaluationProtocol(
        pairs=64, nfes=(20, 5), taus=(0.4,), seed=3, coupling=SamplingCoupling(source_noise_beta=beta)
    )
    gate = evaluate(open_exact_reference(conditions), conditions, protocol, "exact")
    for nfe in (20, 5):
        # On another processor a path may fall on the other side of a boundary; no more than that.
        difference = gate.pair_table(nfe=nfe).sum(axis=0)[:2, :2] - GOLDEN[beta][nfe]
        assert np.abs(difference).max() <= 1
    residual = summarise_strata(gate.strata["position"].at(gate.index())).mean
    assert residual == pytest.approx(GOLDEN[beta]["residual"], rel=1e-3)


def test_a_group_of_conditions_draws_what_it_would_draw_alone(conditions):
    """Groups, NFEs and thresholds are keyed apart: adding one leaves the counts of the others as they were."""
    few = EvaluationProtocol(pairs=16, nfes=(5,))
    many = EvaluationProtocol(pairs=16, nfes=(20, 5, 3), taus=(0.4, 0.7))
    sampler = open_exact_reference(conditions)
    alone, among = (evaluate(sampler, conditions, protocol, "exact") for protocol in (few, many))
    np.testing.assert_array_equal(alone.pair_table(), among.pair_table(tau=0.55, nfe=5))
    seeds = [many.group_seeds(nfe, group)[0] for nfe in many.nfes for group in range(4)]
    assert len(set(seeds)) == len(seeds)
    assert many.group_seeds(20, 2, 5)[:1] == many.group_seeds(20, 2)


def test_the_first_conditions_of_a_bank_are_a_bank(conditions, ring_data):
    first = open_conditions(ring_data / "test", 3)
    assert len(first) == 3
    np.testing.assert_array_equal(first.state, conditions.state[:3])
    np.testing.assert_array_equal(first.direction, conditions.direction[:3])


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"pairs": 0}, "not positive"),
        ({"nfes": ()}, "one or more"),
        ({"nfes": (20, 0)}, "at least 1"),
        ({"taus": (0.0,)}, "above 0"),
        ({"seed": -1}, "negative"),
        ({"coupling": SamplingCoupling(source_noise_beta=1.5)}, "outside"),
    ],
)
def test_a_protocol_out_of_range_is_refused(fields, sentence):
    with pytest.raises(ValueError, match=sentence):
        EvaluationProtocol(**fields)
