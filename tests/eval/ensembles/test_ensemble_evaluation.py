"""Ensembles of the exact reference: one field sampled twice, with private and with shared noise."""

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.ensembles.evaluation import evaluate_ensemble
from dualhead_eval.evaluation.samplers import open_conditions, open_exact_reference
from dualhead_eval.gate.file import read_gate, write_gate
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.run_summary import summarise_run


@pytest.fixture(scope="module")
def bank(ring_data):
    return open_conditions(ring_data / "test")


def test_shared_noise_makes_equal_members_one_and_private_noise_keeps_them_independent(bank, tmp_path):
    members = {f"member {i}": open_exact_reference(bank) for i in range(3)}
    shared = evaluate_ensemble(members, bank, pairs=200, shared_noise=True)
    assert shared.heads == ("member 0", "member 1", "member 2")
    together = summarise_run(shared, heads=(0, 2), draws=10)
    assert together.rho == 1
    assert summarise_strata(shared.strata["member 0 / member 2"].at((0, 0))).mean == 0

    private = evaluate_ensemble(members, bank, pairs=200, shared_noise=False)
    apart = summarise_run(private)
    assert 0 in apart.intervals["rho"]
    summary = summarise_strata(private.strata["member 0 / member 1"].at((0, 0)))
    assert summary.cross_share > 0.9
    assert summary.auroc == 1
    back = read_gate(write_gate(private, tmp_path / "ensemble.json"))
    np.testing.assert_array_equal(back.counts, private.counts)


def test_ensembles_that_do_not_fit_are_refused(bank):
    source = open_exact_reference(bank)
    with pytest.raises(ValueError, match="two or more"):
        evaluate_ensemble({"only": source}, bank)
    with pytest.raises(ValueError, match="layout"):
        evaluate_ensemble({"a": source, "b": replace(source, kinematic_map="ring/polar")}, bank)
