"""The certificate as a LeRobot processor step: labels or positions from anywhere, saved with its pipeline."""

from __future__ import annotations

import json

import numpy as np
import pytest
from lerobot.processor import PolicyProcessorPipeline

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate_step import CoordinationCertificateStep

SIDES = {"name": "side", "tau": 0.1, "parameters": {"normal": [1.0, 0.0]}}


def pipeline(**options):
    return PolicyProcessorPipeline(steps=[CoordinationCertificateStep(**options)], name="watched")


def fed(run, rng, decisions=40, pairs=4, copies=1.0):
    """Feed labels of two heads, of which the second copies the first."""
    for _ in range(decisions):
        first = rng.integers(2, size=(64, pairs))
        second = np.where(rng.random(first.shape) < copies, first, 1 - first)
        answer = run({"info": {"first": first, "second": second}})
    return answer["info"]["coordination"]


def test_labels_from_anywhere_come_to_the_certificates_own_verdict():
    run, rng = pipeline(n_modes=2), np.random.default_rng(0)
    report = fed(run, rng)
    certificate = CoordinationCertificate(n_modes=2)
    rng = np.random.default_rng(0)
    for _ in range(40):
        first = rng.integers(2, size=(64, 4))
        rng.random(first.shape)
        certificate.update(first, first)
    assert report["verdict"] == certificate.verdict == "coordinated"
    assert report["decisions"] == 40 * 64
    assert report["delta"] == certificate.delta


def test_positions_are_labelled_by_a_partition_without_code():
    run = pipeline(partition=SIDES)
    left, right = np.full((8, 5, 2), -0.5), np.full((8, 5, 2), 0.5)
    near = np.zeros((8, 5, 2))
    assert run({"info": {"first": left, "second": right}})["info"]["coordination"]["valid_rate"] == 1
    report = run({"info": {"first": left, "second": near}})["info"]["coordination"]
    assert report["valid_rate"] == 0.5
    assert report["decisions"] == 2


def test_transitions_that_are_no_decision_pass_with_the_last_report():
    run = pipeline(n_modes=3)
    before = {"observation.state": np.ones(2), "info": {"other": 1}}
    answer = run(before)
    assert answer["info"]["other"] == 1
    assert answer["info"]["coordination"]["decision"] is False
    assert (answer["observation.state"] == before["observation.state"]).all()
    assert before["info"] == {"other": 1}


def test_a_saved_pipeline_goes_on_where_it_stood(tmp_path):
    run, rng = pipeline(partition=SIDES, first="a", second="b"), np.random.default_rng(1)
    for _ in range(20):
        side = rng.choice([-1, 1], size=(16, 4, 3, 2)).astype(float)
        run({"info": {"a": side, "b": side}})
    run.save_pretrained(tmp_path)
    assert not list(tmp_path.glob("*.safetensors"))
    file = next(tmp_path.glob("*.json"))
    again = PolicyProcessorPipeline.from_pretrained(tmp_path, config_filename=file.name)
    side = rng.choice([-1, 1], size=(16, 4, 3, 2)).astype(float)
    reports = [used({"info": {"a": side, "b": side}})["info"]["coordination"] for used in (run, again)]
    assert reports[0] == reports[1]
    assert reports[0]["decisions"] == 21 * 16


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda state: state.update(format="dualhead-certificate/9"), "has format"),
        (lambda state: state["state"].update(n_modes=3), "inconsistent certificate"),
        (lambda state: state["state"].update(decisions="many"), "decisions is no count"),
        (lambda state: state["state"]["delta"].update(total=float("nan")), "a running mean is no number"),
        (lambda state: state["state"].pop("valid"), "inconsistent certificate"),
    ],
)
def test_a_state_that_is_none_is_refused(change, message):
    step = CoordinationCertificateStep(n_modes=2)
    step.certificate.update([[0, 1, 0]], [[0, 1, 1]])
    state = json.loads(json.dumps(step.get_config()["state"]))
    CoordinationCertificateStep(n_modes=2, state=state)
    change(state)
    with pytest.raises(ValueError, match=message):
        CoordinationCertificateStep(n_modes=2, state=state)


def test_bad_input_is_refused_in_a_sentence():
    run = pipeline(n_modes=2)
    with pytest.raises(ValueError, match="holds 'first' alone"):
        run({"info": {"first": [0, 1]}})
    with pytest.raises(ValueError, match="give the step a partition"):
        run({"info": {"first": np.zeros((4, 3, 2)), "second": np.zeros((4, 3, 2))}})
    with pytest.raises(ValueError, match="one number of modes"):
        CoordinationCertificateStep()
    with pytest.raises(ValueError, match="one number of modes"):
        CoordinationCertificateStep(n_modes=3, partition=SIDES)
    with pytest.raises(ValueError, match=r"describes no partition|has .*normal"):
        CoordinationCertificateStep(partition={"name": "side", "tau": 0.1, "parameters": {"normal": []}})
