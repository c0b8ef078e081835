"""VFD of real members: the draws, modes and scores that its gates count."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dualhead_eval.ensembles.evaluation import evaluate_ensemble
from dualhead_eval.ensembles.members import open_members
from dualhead_eval.ensembles.scores import time_weight, vfd_score
from dualhead_eval.ensembles.velocity_disagreement import evaluate_velocity_disagreement
from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import open_exact_reference
from dualhead_eval.gate import read_gate, write_gate

PROTOCOL = EvaluationProtocol(pairs=24, nfes=(8,))


@pytest.fixture(scope="module")
def bank(ring_data):
    return open_conditions(ring_data / "test")


@pytest.fixture(scope="module")
def opened(members):
    return open_members(members)


@pytest.fixture(scope="module")
def gates(opened, bank):
    return evaluate_velocity_disagreement(opened, bank, PROTOCOL, "ensemble")


def test_its_draws_and_modes_are_those_of_the_ensemble_with_shared_noise(opened, bank, gates):
    shared = evaluate_ensemble(opened, bank, PROTOCOL, "ensemble", shared_noise=True)
    for gate in gates.values():
        np.testing.assert_array_equal(gate.counts, shared.counts)
        assert gate.strata.keys() == shared.strata.keys()
    assert len(shared.strata) == 3


def test_a_stratum_holds_the_mean_of_both_orders(opened, bank, gates):
    """Computed anew for the first group of conditions, from the policies' own fields."""
    number = len(bank)
    seed = PROTOCOL.group_seeds(8, 0)[0]
    fields, source = [], None
    for member in list(opened.values())[:2]:
        policy = member.sampler
        generator = torch.Generator().manual_seed(seed)
        shape = (number, PROTOCOL.pairs, policy.config.chunk_size)
        noise = {head: torch.randn(*shape, d, generator=generator) for head, d in policy.model.head_dims.items()}
        source = noise["position"].flatten(0, 1).numpy()
        raw = {key: torch.from_numpy(np.repeat(value, PROTOCOL.pairs, 0)) for key, value in bank.observation.items()}
        fields.append(policy.velocity_field(member.preprocess(raw)))
    for score, weighted in (("vfd", True), ("vfd_unweighted", False)):
        both = vfd_score(fields, source, num_steps=8, weighted=weighted)
        expected = 0.5 * (both[0, 1] + both[1, 0]).reshape(number, PROTOCOL.pairs).sum(axis=1)
        valid = gates[score].pair_table(0, 1)[:, :-1, :-1].sum(axis=(1, 2))
        first = next(iter(gates[score].strata))
        total = gates[score].strata[first].at(gates[score].index()).total.sum(axis=-1)
        whole = valid == PROTOCOL.pairs
        assert whole.any(), "some conditions have only valid pairs"
        np.testing.assert_allclose(total[whole], expected[whole], rtol=1e-4)


def test_the_weight_moves_the_score_to_late_times(gates):
    weights = [time_weight(step / 8) for step in range(8)]
    for name, weighted in gates["vfd"].strata.items():
        plain = gates["vfd_unweighted"].strata[name]
        assert weighted.total.sum() <= max(weights) * plain.total.sum()
        assert (weighted.n == plain.n).all()
        assert weighted.unit == plain.unit == "1"


def test_its_gates_are_read_back(gates, tmp_path):
    back = read_gate(write_gate(gates["vfd"], tmp_path / "vfd.gate.json.gz"))
    np.testing.assert_array_equal(back.counts, gates["vfd"].counts)
    assert back.provenance["score"] == "vfd"


def test_the_joint_head_has_a_score_too(opened, bank):
    few = EvaluationProtocol(pairs=4, nfes=(4,))
    gates = evaluate_velocity_disagreement(opened, bank[:3], few, "joints", head="joint")
    shared = evaluate_ensemble(opened, bank[:3], few, "joints", head="joint", shared_noise=True)
    np.testing.assert_array_equal(gates["vfd"].counts, shared.counts)


def test_members_that_cannot_be_compared_are_refused(opened, bank):
    first, second, *_ = opened.values()
    reference = open_exact_reference(bank)
    with pytest.raises(ValueError, match="member 'b' is a ExactReference, expected a trained policy"):
        evaluate_velocity_disagreement({"a": first, "b": reference}, bank, PROTOCOL, "e")
    with pytest.raises(ValueError, match="two or more"):
        evaluate_velocity_disagreement({"a": first}, bank, PROTOCOL, "e")
    scale = second.sampler.model.action_scale.scale
    kept = scale.clone()
    try:
        scale.mul_(2)
        with pytest.raises(ValueError, match="'a' and 'b' normalise actions by different scales"):
            evaluate_velocity_disagreement({"a": first, "b": replace(second)}, bank, PROTOCOL, "e")
    finally:
        scale.copy_(kept)
