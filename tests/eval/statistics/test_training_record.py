"""A gate says what was trained, and whether its loss had settled."""

import pytest

from dualhead_eval.statistics.training_record import settled, training_record


@pytest.mark.parametrize(
    ("training", "words"),
    [
        ({"plateaued": True, "judged_loss": "flow_loss"}, "settled"),
        ({"plateaued": False, "judged_loss": "flow_loss"}, "falling"),
        ({"plateaued": True}, "settled (total)"),
        ({}, "unknown"),
    ],
)
def test_the_loss_is_named_by_what_was_judged(make_gate, training, words):
    assert training_record(make_gate(training=training)).loss == words


def test_a_reference_is_exact_and_nobodys_seed(make_gate):
    record = training_record(make_gate(method="exact reference"))
    assert (record.loss, record.seed) == ("exact", None)


def test_recorded_rollouts_say_what_their_policy_is(make_gate):
    policy = {"config": {"seed": 3, "preconditioning": "none"}, "training_step": 500, "checkpoint": "abc"}
    record = training_record(make_gate(rollouts={"policy": policy}))
    assert (record.seed, record.steps, record.checkpoint) == (3, 500, "abc")


def test_several_runs_count_those_that_settled(make_gate):
    records = [
        training_record(make_gate(training={"plateaued": state, "judged_loss": "flow_loss"})) for state in (True, False)
    ]
    assert settled(records) == "1 of 2 settled"
    assert settled([]) == "unknown"
