"""The gate files in results/ can be read, say what they are, and hold the protocol."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualhead_eval.evaluation.rollouts import ROLLOUTS_SUFFIX, read_closed_loop
from dualhead_eval.gate.gate import read_gate
from dualhead_eval.report.inputs import GATE_SUFFIX

FOLDER = Path(__file__).parents[3] / "results"
ROBOT_GATES = sorted(path for env in ("v2", "v3") for path in (FOLDER / env).glob("*" + GATE_SUFFIX))


@pytest.mark.parametrize("path", ROBOT_GATES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_gate_states_its_configuration_budget_and_protocol(path):
    gate = read_gate(path)
    name, _, budget = path.name.removesuffix(GATE_SUFFIX).rpartition("-")
    steps = 1000 * int(budget.removesuffix("k"))
    assert gate.label == f"{name}, {steps} steps"
    assert gate.provenance["training_step"] == gate.provenance["training"]["steps"] == steps
    assert gate.provenance["training"]["batch_size"] == 128
    assert gate.provenance["dataset"]["split"] == "test"
    assert (FOLDER.parent / "configs" / path.parent.name / f"{name}.yaml").is_file()
    assert gate.n_conditions == {"v2": 75, "v3": 36}[path.parent.name]
    assert (gate.counts.reshape(gate.n_conditions, -1).sum(axis=1) == 1280).all()
    assert (gate.reference_nfe, gate.reference_tau) == (20, {"v2": 0.11, "v3": 0.18}[path.parent.name])


def test_closed_loop_outcomes_are_of_at_least_150_episodes():
    found = sorted(FOLDER.rglob("*" + ROLLOUTS_SUFFIX))
    assert found
    assert all(read_closed_loop(path)[1].episodes >= 150 for path in found)
