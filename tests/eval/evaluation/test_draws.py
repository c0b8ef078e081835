"""Pairs of draws: policies of LeRobot's other types, one head of ours, two policies."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from dualhead_eval.cli import main
from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.evaluation.draws import LerobotPaths, PolicyDraws, open_paths
from dualhead_eval.evaluation.open_loop import evaluate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.gate.file import read_gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.statistics.run_summary import summarise_run
from dualhead_eval.statistics.training_record import training_record
from dualhead_policy.pretrained import policy_folder


def evaluated(tmp_path, name, *arguments):
    output = tmp_path / f"{name}.gate.json"
    assert main(["evaluate", *map(str, arguments), "--output", str(output)]) == 0
    return read_gate(output)


def test_an_act_policy_from_lerobot_train_is_evaluated_and_called_deterministic(
    lerobot_runs, ring_data, tmp_path, capsys
):
    data = ["--dataset", ring_data / "test", "--pairs", 64]
    gate = evaluated(tmp_path, "act", "--policy", lerobot_runs["act"], *data)
    shown = capsys.readouterr().out
    assert "deterministic: the policy predicts one chunk per condition" in shown
    assert gate.heads == ("draw 1", "draw 2")
    assert gate.nfes == [1]
    assert (gate.provenance["method"], gate.provenance["deterministic"]) == ("draws of one policy", True)
    assert gate.provenance["config"]["type"] == "act"
    # Every pair of a condition fell into one cell, and both draws into the same.
    table = gate.table()
    assert (table.max(axis=(1, 2)) == 64).all()
    assert np.trace(table.sum(axis=0)) == table.sum()
    record = training_record(gate)
    assert (record.steps, record.seed, record.batch_size) == (150, 0, 32)
    assert mechanism_of(gate).paper_row == ""


def test_the_paths_of_a_policy_are_those_that_it_predicts_alone(lerobot_runs, ring_data):
    conditions = open_conditions(ring_data / "test", 3)
    source = open_paths(lerobot_runs["act"], "position")
    assert isinstance(source, LerobotPaths)
    batch = {key: torch.from_numpy(value[1:2]) for key, value in conditions.observation.items()}
    policy = source.policy
    alone = policy.postprocess(policy.policy.predict_action_chunk(policy.preprocess(batch)))
    paths = source.paths(conditions, 1, 1, seed=0)
    assert np.allclose(paths[1, 0], alone[0, :, 6:].numpy(), atol=1e-5)
    # The joint dimensions reach the plane through the ring's own map.
    joint = open_paths(lerobot_runs["act"], "joint").paths(conditions, 1, 1, seed=0)
    assert joint.shape == paths.shape
    assert not np.allclose(joint, paths)


def test_a_policy_with_a_past_sees_the_frames_before_the_branch(lerobot_runs, panda_data):
    conditions = open_conditions(panda_data / "test")
    frames, present = conditions.frames
    history = conditions.history(2)["observation.state"]
    assert (history[:, 1] == frames.observation["observation.state"][present]).all()
    assert (history[:, 0] == frames.observation["observation.state"][present - 1]).all()
    assert (history[:, 0] != history[:, 1]).any()
    # At an episode's first frame there is no past: it is repeated, as in training.
    first = frames.history(np.array([0]), 3)["observation.state"][0]
    assert (first == first[:1]).all()

    source = open_paths(lerobot_runs["diffusion"], "position")
    policy = source.policy
    assert (policy.n_obs_steps, policy.executed_steps, policy.denoising_steps) == (2, 8, 3)
    paths = source.paths(conditions, 3, 3, seed=4)
    assert paths.shape == (len(conditions), 3, 16, 3)
    assert (paths == source.paths(conditions, 3, 3, seed=4)).all()
    assert not np.allclose(paths[:, 0], paths[:, 1])
    # LeRobot's own closed loop, given the same two observations and random numbers, acts alike.
    own = policy.policy
    own.reset()
    raw = conditions.history(2)
    with torch.random.fork_rng(devices=[]):
        own._queues["action"].append(torch.zeros(len(conditions), 17))
        own.select_action(policy.preprocess({key: torch.from_numpy(value[:, 0]) for key, value in raw.items()}))
        torch.manual_seed(7)
        action = own.select_action(
            policy.preprocess({key: torch.from_numpy(value[:, 1]) for key, value in raw.items()})
        )
    drawn = policy.draw({key: torch.from_numpy(value) for key, value in raw.items()}, 1, seed=7)
    assert torch.allclose(policy.postprocess(action), drawn[:, 0, 0], atol=1e-5)


def test_a_stochastic_policy_is_sampled_at_several_numbers_of_steps(lerobot_runs, panda_data, tmp_path, capsys):
    data = ["--dataset", panda_data / "test", "--pairs", 6]
    gate = evaluated(tmp_path, "diffusion", "--policy", lerobot_runs["diffusion"], *data, "--nfe", 2, 4)
    assert gate.nfes == [2, 4]
    assert gate.provenance["deterministic"] is False
    assert "deterministic" not in capsys.readouterr().out
    output = ["--output", str(tmp_path / "no.gate.json"), *map(str, data)]
    assert main(["evaluate", "--policy", str(lerobot_runs["diffusion"]), *output, "--nfe", "1000"]) == 2
    assert "1 to 100 denoising steps" in capsys.readouterr().err


def test_two_draws_of_one_head_are_independent_and_as_diverse_as_the_head(trained, ring_data, tmp_path):
    data = ["--dataset", ring_data / "test", "--pairs", 400]
    heads = summarise_run(evaluated(tmp_path, "heads", "--policy", trained, *data))
    draws = {
        head: summarise_run(evaluated(tmp_path, head, "--policy", trained, *data, "--draws", head))
        for head in ("position", "joint")
    }
    # Each draw has noise and a token of its own.
    for head, summary in draws.items():
        assert abs(summary.rho) < 0.06, head  # 1 were the draws one and the same; 4800 pairs leave 0.015
        assert summary.capacity == pytest.approx(heads.capacity, abs=0.05)


def test_two_policies_are_one_pair(lerobot_runs, trained, ring_data, tmp_path, capsys):
    pair = ["--pair", lerobot_runs["act"], trained, "--dataset", ring_data / "test", "--pairs", 32]
    gate = evaluated(tmp_path, "pair", *pair)
    assert gate.heads == ("act", "oracle")
    assert gate.provenance["method"] == "two policies"
    assert [told["deterministic"] for told in gate.provenance["policies"]] == [True, False]
    # The first head's labels are the ACT policy's own, the second's those of the other policy's draws.
    alone = evaluated(tmp_path, "act", "--policy", lerobot_runs["act"], "--dataset", ring_data / "test", "--pairs", 32)
    assert (gate.table().sum(axis=2) == alone.table().sum(axis=2)).all()
    assert "deterministic" in capsys.readouterr().out


def test_many_policies_of_several_types_become_a_gate_each(lerobot_runs, trained, ring_data, tmp_path):
    common = ["--dataset", str(ring_data / "test"), "--pairs", "8", "--output", str(tmp_path / "gates")]
    assert main(["evaluate", "--policy", str(lerobot_runs["act"]), str(trained), *common]) == 0
    act, ours = (read_gate(tmp_path / "gates" / f"{name}.gate.json") for name in ("act", "oracle"))
    assert (act.heads, ours.heads) == (("draw 1", "draw 2"), ("joint", "position"))
    assert (act.nfes, ours.nfes) == ([1], [20])


def test_what_does_not_fit_is_refused_in_a_sentence(lerobot_runs, trained, ring_data, panda_data, tmp_path, capsys):
    def refusal(*arguments):
        output = tmp_path / "no.gate.json"
        assert main(["evaluate", *map(str, arguments), "--output", str(output)]) == 2
        assert not output.exists()
        return capsys.readouterr().err

    act = ["--policy", lerobot_runs["act"]]
    assert "observation.state of shape" in refusal(*act, "--dataset", panda_data / "test")
    assert "leave --nfe out" in refusal(*act, "--dataset", ring_data / "test", "--nfe", 5)
    ring = ["--dataset", ring_data / "test"]
    for option in (("--source-noise-beta", 0), ("--token-draw", "uniform"), ("--redraw-token",)):
        assert "about both heads of a dual-head policy" in refusal(*act, *ring, *option)
    assert "about both heads of a dual-head policy" in refusal(
        "--policy", trained, *ring, "--draws", "joint", "--update-card"
    )
    assert "goes with --partition" in refusal(*act, *ring, "--horizon", 4)
    assert "holds no policy" in refusal("--policy", tmp_path / "nothing", *ring)
    source = open_paths(lerobot_runs["act"], "position")
    longer = open_conditions(ring_data / "test", 2)
    object.__setattr__(longer, "horizon", 17)
    with pytest.raises(ValueError, match="predicts 16 steps from the present one, modes are told in 17"):
        evaluate(PolicyDraws(source), longer, EvaluationProtocol(pairs=2), "too short")


def test_a_policy_that_the_user_loaded_is_evaluated_as_the_documentation_says(lerobot_runs, ring_data):
    from lerobot.policies import make_pre_post_processors
    from lerobot.policies.act.modeling_act import ACTPolicy

    page = (Path(__file__).parents[3] / "docs" / "any_policy.md").read_text()
    code = re.search(r"```python\n(.*?)```", page, flags=re.DOTALL)
    names: dict = {}
    exec(compile(code.group(1), "any_policy.md", "exec"), names)
    folder = str(policy_folder(lerobot_runs["act"]))
    policy = ACTPolicy.from_pretrained(folder)
    gate = names["gate_of"](
        policy, *make_pre_post_processors(policy.config, pretrained_path=folder), ring_data / "test"
    )
    protocol = EvaluationProtocol(pairs=64, nfes=(1,))
    conditions = open_conditions(ring_data / "test")
    opened = evaluate(PolicyDraws(open_paths(lerobot_runs["act"], "position")), conditions, protocol, "act")
    assert (gate.counts == opened.counts).all()
