"""A run beside the paper's row says in what its training departs from the paper's."""

import pytest

from dualhead_eval.paper.setting import departures
from dualhead_eval.statistics.training_record import training_record

PAPERS = {
    "preconditioning": "none",
    "conditioning": "concat",
    "observation_noise": 0.0,
    "padded_steps": 0,
    "optimizer_lr": 3e-4,
    "lr_schedule": "constant",
}
BUDGET = {"batch_size": 128, "steps": 50_000}


@pytest.mark.parametrize(
    ("config", "training", "words"),
    [
        ({}, {}, "nothing known"),
        ({"conditioning": "film"}, {}, "network"),
        ({"observation_noise": 0.05, "padded_steps": 15}, {}, "noise on observations, padding"),
        ({}, {"steps": 20_000, "batch_size": 64}, "batch size, steps"),
    ],
)
def test_departures_are_named(make_gate, config, training, words):
    gate = make_gate(config={**PAPERS, **config}, training={**BUDGET, **training})
    assert departures(training_record(gate)) == words


def test_a_reference_was_not_trained(make_gate):
    assert departures(training_record(make_gate(method="exact reference"))) == "not trained"
