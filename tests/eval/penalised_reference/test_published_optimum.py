"""The published gates of the optimum say what they are of, and climb with the weight of consistency."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualhead_eval.gate import read_gate
from dualhead_eval.statistics.run_summary import summarise_run
from dualhead_eval.studies.study_plan import GATE_SUFFIX

FOLDER = Path(__file__).parents[3] / "results" / "optimum"
GATES = {path.name.removesuffix(GATE_SUFFIX): read_gate(path) for path in sorted(FOLDER.glob("*" + GATE_SUFFIX))}


@pytest.mark.parametrize("name", GATES)
def test_a_gate_of_the_optimum_is_named_after_its_weight_and_holds_the_protocol(name):
    gate = GATES[name]
    _, _, weight = name.partition("_beta_")[0].partition("_consistency_")
    assert gate.label == name
    assert gate.provenance["method"].startswith("penalised")
    assert gate.provenance["consistency_weight"] == float(weight)
    assert gate.provenance["source_noise_beta"] == float(name.partition("_beta_")[2] or 0)
    assert gate.reference_nfe == 20
    assert (gate.counts.reshape(gate.n_conditions, -1).sum(axis=1) == 1280).all()


@pytest.mark.parametrize(
    ("where", "weights"),
    [
        ("nullspace", ("0.1", "0.3", "1", "3")),
        ("orthogonal", ("0.1", "0.3", "1", "3")),
        ("polar", ("0.1", "0.3", "1", "3")),
        ("p92", ("0.1", "0.3", "1", "3")),
        ("v2", ("0.3", "1", "3", "10", "100")),
        ("v3", ("0.3", "1", "3", "100")),
    ],
)
def test_coordination_climbs_with_the_weight_and_validity_does_not_fall(where, weights):
    runs = [summarise_run(GATES[f"{where}_consistency_{weight}"]) for weight in weights]
    rho = [run.rho for run in runs]
    assert rho == sorted(rho)
    assert max(run.valid_rate for run in runs) - min(run.valid_rate for run in runs) < 0.005


def test_the_optimum_loses_the_rarer_of_two_modes_as_consistency_weighs_more():
    capacities = [summarise_run(GATES[f"p92_consistency_{weight}"]).capacity for weight in ("0.1", "0.3", "1", "3")]
    assert capacities == sorted(capacities, reverse=True)
    assert summarise_run(GATES["unequal_consistency_3"]).capacity == pytest.approx(0.5, abs=0.005)  # equally likely
