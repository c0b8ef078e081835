"""Closed loop of LeRobot's other policies: what is executed, what is recorded, what is refused."""

from __future__ import annotations

import json

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset

from dualhead_envs.dataset_columns import read_columns, read_info
from dualhead_eval.cli import main
from dualhead_eval.evaluation.draw_decisions import DrawDecisions
from dualhead_eval.gate.file import read_gate
from dualhead_policy.lerobot_policies.opening import open_lerobot_policy
from dualhead_policy.pretrained import policy_folder


def test_an_act_policy_is_rolled_out_and_recorded(lerobot_runs, ring_data, tmp_path, capsys):
    output, root = tmp_path / "act.gate.json", tmp_path / "rollouts"
    arguments = ["--policy", str(lerobot_runs["act"]), "--dataset", str(ring_data / "test"), "--output", str(output)]
    assert main(["evaluate", *arguments, "--record", str(root), "--episodes", "3", "--control", "position"]) == 0
    assert "position head driving: success" in capsys.readouterr().out
    gate = read_gate(output)
    assert gate.heads == ("draw 1", "draw 2")
    assert gate.counts.sum() == 3 * 2  # one decision an episode, two pairs each
    dataset = LeRobotDataset("local/rollouts", root=root, video_backend="pyav")
    first = dataset[0]
    # What was executed is the first draw; the policy is deterministic, so that all draws are one.
    draws = first["prediction.draw_1"].reshape(2, 16, 2)
    assert np.allclose(first["action"][6:], draws[0, 0])
    assert torch.equal(first["prediction.draw_1"], first["prediction.draw_2"])
    # LeRobot's own way to act predicts the same action.
    policy = open_lerobot_policy(policy_folder(lerobot_runs["act"]))
    keys = ("observation.state", "observation.environment_state")
    policy.policy.reset()
    action = policy.policy.select_action(policy.preprocess({key: first[key][None] for key in keys}))
    assert torch.allclose(policy.postprocess(action)[0], first["action"], atol=1e-5)
    sidecar = json.loads((root / "meta" / "dualhead.json").read_text())
    assert sidecar["policy"]["config"]["type"] == "act"


def test_decisions_look_back_on_what_was_seen_in_between(lerobot_runs, panda_data, tmp_path):
    root = tmp_path / "rollouts"
    arguments = ["--policy", str(lerobot_runs["diffusion"]), "--dataset", str(panda_data / "test")]
    arguments += ["--record", str(root), "--episodes", "1", "--samples", "1", "--control", "position", "--seed", "3"]
    assert main(["evaluate", *arguments, "--output", str(tmp_path / "d.gate.json")]) == 0
    keys = ["observation.state", "observation.environment_state", "prediction.draw_1", "prediction.decision", "action"]
    columns = read_columns(root, read_info(root), keys)
    decided = np.flatnonzero(columns["prediction.decision"].reshape(-1))
    assert (np.diff(decided) == 8).all()
    # The second decision, made again from the two frames that it saw and its own seed.
    policy = open_lerobot_policy(policy_folder(lerobot_runs["diffusion"]))
    decisions = DrawDecisions(policy, 1, 16)
    decisions.start(3)
    seeds = [int(decisions.seeds.integers(2**63)) for _ in range(2)]
    for seed, frames in zip(seeds, ([0, 0], [decided[1] - 1, decided[1]]), strict=True):
        history = {key: torch.from_numpy(columns[key][frames])[None] for key in keys[:2]}
        drawn = policy.draw(history, 2, seed)[0]
        path = columns["prediction.draw_1"][frames[1]].reshape(16, 3)
        assert np.allclose(drawn[0, :16, 7:10].numpy(), path, atol=1e-5)
        assert np.allclose(drawn[0, 0].numpy(), columns["action"][frames[1]], atol=1e-5)


def test_an_environment_of_other_dimensions_is_refused(lerobot_runs, panda_data, tmp_path, capsys):
    arguments = ["--policy", str(lerobot_runs["act"]), "--dataset", str(panda_data / "test"), "--episodes", "1"]
    arguments += ["--record", str(tmp_path / "rollouts"), "--output", str(tmp_path / "no.gate.json")]
    assert main(["evaluate", *arguments]) == 2
    assert "the policy was trained on 2" in capsys.readouterr().err
    assert not (tmp_path / "rollouts").exists()
