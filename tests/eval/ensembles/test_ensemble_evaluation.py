"""Ensembles of the exact reference: one field sampled twice, with private and with shared noise."""

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.ensembles.evaluation import evaluate_ensemble
from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.evaluation.open_loop import evaluate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import open_exact_reference
from dualhead_eval.gate import read_gate, write_gate
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.run_summary import summarise_run
from dualhead_policy.kinematics.kinematic_map import KinematicMap

PROTOCOL = EvaluationProtocol(pairs=200, nfes=(20, 5), taus=(0.4,))


@pytest.fixture(scope="module")
def bank(ring_data):
    return open_conditions(ring_data / "test")


def test_shared_noise_makes_equal_members_one_and_private_noise_keeps_them_independent(bank, tmp_path):
    members = {f"member {i}": open_exact_reference(bank) for i in range(3)}
    shared = evaluate_ensemble(members, bank, PROTOCOL, "ensemble", shared_noise=True)
    assert shared.heads == ("member 0", "member 1", "member 2")
    together = summarise_run(shared, heads=(0, 2), draws=10)
    assert together.rho == 1
    assert summarise_strata(shared.strata["member 0 / member 2"].at(shared.index())).mean == 0

    private = evaluate_ensemble(members, bank, PROTOCOL, "ensemble", shared_noise=False)
    apart = summarise_run(private)
    assert 0 in apart.intervals["rho"]
    summary = summarise_strata(private.strata["member 0 / member 1"].at(private.index()))
    assert summary.cross_share > 0.9
    assert summary.auroc == 1
    back = read_gate(write_gate(private, tmp_path / "ensemble.json"))
    np.testing.assert_array_equal(back.counts, private.counts)


def test_ensembles_that_do_not_fit_are_refused(bank):
    member = open_exact_reference(bank)
    with pytest.raises(ValueError, match="two or more"):
        evaluate_ensemble({"only": member}, bank, PROTOCOL, "ensemble")
    other = replace(member, kinematics=KinematicMap("ring/polar"))
    with pytest.raises(ValueError, match="member 'b': the policy's layout"):
        evaluate_ensemble({"a": member, "b": other}, bank, PROTOCOL, "ensemble")
    with pytest.raises(ValueError, match="choose one of these"):
        evaluate_ensemble({"a": member, "b": member}, bank, PROTOCOL, "ensemble", head="rotation")


def test_an_ensemble_is_counted_like_a_policy(bank):
    """The members' gate names versions and protocol, and holds every NFE and threshold, as every other gate does."""
    members = {name: open_exact_reference(bank) for name in ("first", "second")}
    ensemble = evaluate_ensemble(members, bank, PROTOCOL, "ensemble")
    policy = evaluate(members["first"], bank, PROTOCOL, "policy")
    assert ensemble.counts.shape == policy.counts.shape == (2, 2, 12, 3, 3)
    assert ensemble.provenance["versions"] == policy.provenance["versions"]
    assert ensemble.provenance["seed"] == policy.provenance["seed"]
    # Members that share their noise start from the draws that the policy alone would have started from.
    positions = policy.pair_table(1, 0, nfe=5).sum(axis=-1)
    for member in (0, 1):
        np.testing.assert_array_equal(ensemble.pair_table(member, 1 - member, nfe=5).sum(axis=-1), positions)
