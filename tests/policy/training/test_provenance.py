"""What a gate file says of a policy: which weights, and whether its flow loss had stopped falling."""

import hashlib
import json

import pytest

from dualhead_eval.evaluation.samplers import open_policy
from dualhead_policy.pretrained import policy_folder
from dualhead_policy.training.provenance import training_summary


def write_log(root, lines):
    (root / "training_log.jsonl").write_text(
        "".join(json.dumps({"step": 200 * i} | line) + "\n" for i, line in enumerate(lines, 1))
    )
    folder = root / "checkpoints" / "000100" / "pretrained_model"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def test_the_plateau_is_judged_on_the_flow_loss(tmp_path):
    """Free bits hold the total loss up while the flow loss still falls, and the other way round."""
    falling = [{"loss": 2.0, "flow_loss": 1.0 / (1 + step)} for step in range(100)]
    summary = training_summary(write_log(tmp_path, falling))
    assert (summary["plateaued"], summary["judged_loss"]) == (False, "flow_loss")
    settled = [{"loss": 2.0 - 0.01 * step, "flow_loss": 0.5} for step in range(100)]
    summary = training_summary(write_log(tmp_path, settled))
    assert (summary["plateaued"], summary["judged_loss"]) == (True, "flow_loss")
    assert summary["final_loss"] == pytest.approx(0.5)


def test_a_log_without_the_flow_loss_says_that_its_total_loss_was_judged(tmp_path):
    summary = training_summary(write_log(tmp_path, [{"loss": 1.0}] * 20))
    assert (summary["plateaued"], summary["judged_loss"]) == (True, "loss")


def test_a_checkpoint_is_known_by_its_weights(trained):
    weights = policy_folder(trained) / "model.safetensors"
    expected = hashlib.sha256(weights.read_bytes()).hexdigest()
    assert open_policy(trained).provenance["checkpoint"] == expected
