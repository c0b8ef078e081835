"""A policy's folder with a certificate in its preprocessor: the same actions, and a verdict in unmodified LeRobot."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.processor import PolicyProcessorPipeline

from dualhead_eval.cli import main
from dualhead_policy.decision_hooks import LISTENERS
from dualhead_policy.pretrained import load_policy, policy_folder

PREPROCESSOR = "policy_preprocessor.json"
SIDES = {"name": "side", "tau": 0.1, "parameters": {"normal": [1.0, 0.0]}}


@pytest.fixture(scope="module")
def certified(trained, ring_data, tmp_path_factory):
    """A briefly trained policy of the ring that decides twice an episode, plain and certified."""
    folder = tmp_path_factory.mktemp("certified")
    plain = shutil.copytree(policy_folder(trained), folder / "plain")
    config = json.loads((plain / "config.json").read_text())
    (plain / "config.json").write_text(json.dumps(config | {"n_action_steps": 8}))
    where = ["--policy", str(plain), "--output", str(folder / "certified")]
    assert main(["certify", "--dataset", str(ring_data / "test"), "--draws", "6", *where]) == 0
    return plain, folder / "certified"


def step_of(folder):
    return json.loads((folder / PREPROCESSOR).read_text())["steps"][3]


def rolled_out(policy, preprocess, episodes=2):
    """Actions of some episodes, and the last ``info`` of the preprocessor."""
    env = gym.make("dualhead_envs:RotatingRing-v2", representation="nullspace", control="position")
    torch.manual_seed(0)
    actions, info = [], {}
    for episode in range(episodes):
        observation, _ = env.reset(seed=episode)
        policy.reset()
        for _ in range(16):
            raw = {
                "observation.state": torch.from_numpy(observation["agent_pos"])[None],
                "observation.environment_state": torch.from_numpy(observation["environment_state"])[None],
            }
            batch = preprocess(raw)
            info = batch["info"]
            actions.append(policy.select_action(batch)[0].numpy())
            observation, *_ = env.step(actions[-1][-2:])
    return np.stack(actions), info


def test_a_certified_policy_executes_what_it_would_have_executed_and_counts_its_decisions(certified):
    plain, folder = certified
    alone, info = rolled_out(*load_policy(plain))
    assert "coordination" not in info
    policy, preprocess = load_policy(folder)
    beside, info = rolled_out(policy, preprocess)
    np.testing.assert_array_equal(alone, beside)
    assert info["coordination"]["decisions"] == 4
    certificate = preprocess.steps[3].certificate
    # Its labels are those of the environment's partition under the raw observation: drawn again, they are the same.
    again = load_policy(folder)[1].steps[3]
    assert again.certificate.reading.decisions == 0
    assert certificate.reading.kind == "conditional"
    assert certificate.to_dict()["state"]["pairs"] == 4 * 6


def test_the_draws_of_a_decision_are_labelled_by_the_environments_partition(certified):
    policy, preprocess = load_policy(certified[1])
    env = gym.make("dualhead_envs:RotatingRing-v2", representation="nullspace", control="position")
    observation, _ = env.reset(seed=3)
    step, given = preprocess.steps[3], []
    original = policy.sample

    def sample(batch, number, **options):
        if number == 6:
            given.append(original(batch, number, **options))
            return given[-1]
        return original(batch, number, **options)

    policy.sample = sample
    policy.reset()
    policy.select_action(preprocess({
        "observation.state": torch.from_numpy(observation["agent_pos"])[None],
        "observation.environment_state": torch.from_numpy(observation["environment_state"])[None],
    }))  # fmt: skip
    (drawn,) = given
    partition, condition = env.unwrapped.mode_partition, observation["environment_state"].astype(float)
    paths = policy.model.kinematics.position(drawn.joint.double())[0].numpy(), drawn.position[0].double().numpy()
    joint, position = (partition.assign(path, condition) for path in paths)
    both = (joint >= 0) & (position >= 0)
    state = step.certificate.to_dict()["state"]
    assert (state["valid_pairs"], state["agreeing"]) == (both.sum(), (both & (joint == position)).sum())


def test_no_two_episodes_draw_the_same(certified):
    """A certificate whose draws repeated with every episode would count one piece of evidence many times."""
    policy, preprocess = load_policy(certified[1])
    seen = []
    original = policy.sample

    def sample(batch, number, **options):
        samples = original(batch, number, **options)
        if number == 6:
            seen.append(samples.position)
        return samples

    policy.sample = sample
    for _ in range(2):
        rolled_out(policy, preprocess, episodes=1)  # the same episode twice
    assert len(seen) == 4
    assert not torch.equal(seen[0], seen[2])


def test_a_partition_without_code_certifies_too_and_listens_no_longer_than_it_lives(certified, tmp_path):
    (tmp_path / "sides.json").write_text(json.dumps(SIDES))
    where = ["--policy", str(certified[0]), "--output", str(tmp_path / "P")]
    assert main(["certify", "--partition", str(tmp_path / "sides.json"), *where]) == 0
    before = len(LISTENERS)
    policy, preprocess = load_policy(tmp_path / "P")
    assert len(LISTENERS) == before + 1
    _, info = rolled_out(policy, preprocess)
    assert info["coordination"]["decisions"] == 4
    del preprocess
    assert len(LISTENERS) == before


def test_a_saved_preprocessor_goes_on_where_it_stood(certified, tmp_path):
    policy, preprocess = load_policy(certified[1])
    rolled_out(policy, preprocess)
    folder = shutil.copytree(certified[1], tmp_path / "P")
    preprocess.save_pretrained(folder, config_filename=PREPROCESSOR)
    policy, preprocess = load_policy(folder)
    assert preprocess.steps[3].certificate.reading.decisions == 4
    rolled_out(policy, preprocess)
    assert preprocess.steps[3].certificate.reading.decisions == 8


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"draws": 1}, "draws = 1"),
        ({"draws": 10**9}, "draws = 1000000000"),
        ({"alpha": 2.0}, "alpha = 2"),
        ({"surprise": 1}, "unknown field .*surprise"),
        ({"environment": {"env_id": "CartPole-v1", "env_kwargs": {}}}, "names no environment of dualhead_envs"),
        ({"environment": {"env_id": "RotatingRing-v2", "env_kwargs": {"xml_file": "/etc/passwd"}}}, "does not take"),
        ({"environment": {"env_id": "RotatingRing-v2"}}, "lacks the field .*env_kwargs"),
        ({"environment": None}, "n_modes=None"),
        ({"partition": SIDES}, "one of the two"),
        ({"environment": None, "partition": {"name": "os:system"}}, "partition"),
        ({"state": {"format": "dualhead-certificate/9"}}, "has format"),
    ],
)
def test_a_certified_folder_loads_strictly(certified, tmp_path, change, sentence):
    folder = shutil.copytree(certified[1], tmp_path / "P")
    content = json.loads((folder / PREPROCESSOR).read_text())
    content["steps"][3]["config"] |= change
    (folder / PREPROCESSOR).write_text(json.dumps(content))
    with pytest.raises(ValueError, match=sentence) as refusal:
        load_policy(folder)
    assert PREPROCESSOR in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_step_stands_where_observations_are_raw(certified, tmp_path):
    folder = shutil.copytree(certified[1], tmp_path / "P")
    content = json.loads((folder / PREPROCESSOR).read_text())
    steps = content["steps"]
    content["steps"] = [*steps[:3], steps[4], steps[3]]
    (folder / PREPROCESSOR).write_text(json.dumps(content))
    with pytest.raises(ValueError, match="policy_preprocessor"):
        load_policy(folder)


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [(["--draws", "1"], "2 pairs or more"), (["--alpha", "0"], "between 0 and 1"), (["--seed", "-1"], "at least 0")],
)
def test_bad_options_are_refused_and_leave_nothing(certified, ring_data, tmp_path, capsys, flags, sentence):
    where = ["--policy", str(certified[0]), "--dataset", str(ring_data / "test"), "--output", str(tmp_path / "P")]
    assert main(["certify", *where, *flags]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "P").exists()


def test_certifying_again_replaces_the_certificate(certified, ring_data, tmp_path):
    where = ["--policy", str(certified[1]), "--dataset", str(ring_data / "test"), "--output", str(tmp_path / "P")]
    assert main(["certify", *where, "--draws", "4"]) == 0
    content = json.loads((tmp_path / "P" / PREPROCESSOR).read_text())
    assert len(content["steps"]) == 5
    assert step_of(tmp_path / "P")["config"]["draws"] == 4


def test_an_observation_without_the_condition_is_refused(certified):
    step = load_policy(certified[1])[1].steps[3]
    with pytest.raises(ValueError, match=r"no observation\.environment_state"):
        PolicyProcessorPipeline(steps=[step])({"observation.state": torch.zeros(1, 2)})


def test_unmodified_lerobot_eval_comes_to_a_verdict(certified, tmp_path):
    command = [
        str(Path(sys.executable).parent / "lerobot-eval"), f"--policy.path={certified[1]}", "--policy.device=cpu",
        "--env.type=rotating_ring", "--env.representation=nullspace", "--env.control=position",
        "--eval.n_episodes=8", "--eval.batch_size=2", "--seed=5", f"--output_dir={tmp_path / 'eval'}",
    ]  # fmt: skip
    ended = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert ended.returncode == 0, ended.stderr[-2000:]
    said = re.findall(
        r"coordination certificate: (\d+) decisions, valid ([\d.]+), rho \S+ \[[^]]*\]: ([\w-]+)", ended.stderr
    )
    counts = [int(count) for count, *_ in said]
    # Two decisions in each of eight episodes; the last line is that of the end.
    assert counts == sorted(counts)
    assert counts[-1] == 16
    assert said[-1][2] == "insufficient"  # sixteen decisions are no evidence
