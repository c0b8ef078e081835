"""Seeds and checkpoints of one mechanism stand together; an answer says in two sentences what each kind of run does."""

import re

import pytest

from dualhead_eval.report.answer import group_doings, report_answer
from dualhead_eval.report.content import make_report
from dualhead_eval.report.run_groups import group_runs


@pytest.fixture(scope="module")
def checkpoints(make_gate):
    """Two seeds of one mechanism at two checkpoints each, in a muddled order, and a run of another mechanism."""

    def gate(seed, steps, couple):
        return make_gate(
            f"token seed {seed}, {steps} steps",
            couple,
            seed=seed + steps,
            partition="bypass-v2",
            config={"seed": seed, "token": "oracle"},
            training={"steps": 50_000, "seed": seed},
            training_step=steps,
            checkpoint=f"{seed}-{steps}",
        )

    other = make_gate("A", 0.0, seed=7, partition="bypass-v2", config={"seed": 0, "source_noise_beta": 1.0})
    return [gate(1, 50_000, 0.95), other, gate(0, 50_000, 0.95), gate(1, 20_000, 0.4), gate(0, 20_000, 0.4)]


def test_checkpoints_of_one_mechanism_are_a_group_by_seed_and_steps(checkpoints):
    token, other = group_runs(make_report(checkpoints).runs)
    assert [token.member(run) for run in token.runs] == [
        "seed 0, 20,000 steps", "seed 0, 50,000 steps", "seed 1, 20,000 steps", "seed 1, 50,000 steps",
    ]  # fmt: skip
    assert token.label == "token"
    assert [run.training.seed for run in token.last] == [0, 1]
    assert [[run.training.steps for run in runs] for runs in token.trainings] == [[20_000, 50_000]] * 2
    assert other.label == "A"
    assert other.trainings == []


def test_networks_tell_groups_of_one_name_apart(make_gate):
    def gate(noise, seed):
        network = {"preconditioning": "none", "conditioning": "concat", "velocity_layers": 4, "velocity_width": 256}
        config = {**network, "observation_noise": noise, "padded_steps": 0, "seed": seed}
        return make_gate("G", 0.5, seed=seed, config=config)

    labels = [group.label for group in group_runs(make_report([gate(0.0, 0), gate(0.05, 1)]).runs)]
    assert labels == ["G (noise 0.0)", "G (noise 0.05)"]


def test_tables_of_labels_are_no_seeds_of_one_mechanism(make_gate):
    gates = [make_gate("mine", 0.5, method="label table"), make_gate("yours", 0.9, seed=1, method="label table")]
    assert [group.label for group in group_runs(make_report(gates).runs)] == ["mine", "yours"]


def test_an_answer_counts_the_last_checkpoints_alone(checkpoints):
    report = make_report(checkpoints)
    assert group_doings(group_runs(report.runs)) == {"coordinated in full": [0], "uncoordinated": [1]}
    answer = report_answer(report)
    assert answer.what == (
        "In 1 of 2 kinds of run the heads choose the same mode almost whenever they can, with every mode alive; "
        "and in 1 they choose independently of each other."
    )
    for sentence in (answer.what, answer.trust):
        assert len(re.findall(r"[.](?:\s|$)", sentence)) == 1


def test_one_run_is_answered_with_its_numbers(make_gate):
    report = make_report([make_gate("mine", 0.9, method="label table")])
    (pair,) = report.pairs
    answer = report_answer(report)
    assert f"{pair.rho:+.1%}" in answer.what
    assert "mine" in answer.what
    assert answer.trust.startswith("Nothing is known of a training")


def test_an_unreadable_run_is_not_called_anything_else(make_gate):
    assert "too few valid pairs" in report_answer(make_report([make_gate("few", 0.9, valid=0.3)])).what


def test_seeds_that_disagree_are_said_to(make_gate):
    gates = [
        make_gate(f"unstable seed {seed}", couple, seed=seed, config={"seed": seed}, partition="bypass-v2")
        for seed, couple in enumerate((0.0, 0.95))
    ]
    assert "not do the same under every seed" in report_answer(make_report(gates)).what
