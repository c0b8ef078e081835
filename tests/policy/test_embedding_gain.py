"""Three and more equally likely modes: a token's effect is its product with the condition, and that has to be read."""

from __future__ import annotations

import json
import shutil

import pytest
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from dualhead_envs.ring.record import record_ring
from dualhead_policy import DualheadConfig
from dualhead_policy.pretrained import load_policy, policy_folder
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training


@pytest.fixture(scope="module")
def four_modes(tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "ring4"
    more = {"env_kwargs": {"representation": "nullspace"}}
    return record_ring("RotatingRing-v4", root, episodes=20_000, conditions=4, **more)


def new_policy(root, **fields):
    meta = LeRobotDatasetMetadata("local/ring", root=root / "train")
    return make_policy(DualheadConfig(device="cpu", **fields), ds_meta=meta)


def gain(root, **fields):
    return new_policy(root, **fields).config.embedding_gain


def test_the_embedding_is_amplified_where_more_than_two_modes_are_to_be_told_apart(four_modes, ring_data):
    assert gain(four_modes) == 8
    assert gain(four_modes, embedding_gain=2.0) == 2
    assert gain(four_modes, conditioning="concat") == 1
    assert gain(ring_data) == 1


def test_the_gain_multiplies_the_embedding(four_modes):
    one, two = (new_policy(four_modes, embedding_gain=factor) for factor in (1.0, 2.5))
    two.load_state_dict(one.state_dict())
    observation = one.model.observation_range.high[None]
    assert one.model.embed(observation).abs().max() > 0
    assert ((2.5 * one.model.embed(observation) - two.model.embed(observation)).abs() < 1e-6).all()


def test_a_checkpoint_older_than_the_field_has_none_whatever_it_was_trained_on(four_modes, tmp_path):
    flags = [f"--dataset.root={four_modes / 'train'}", f"--output_dir={tmp_path / 'run'}", "--steps=1"]
    Training(parse_training_config([*flags, "--policy.device=cpu"], None)).run()
    folder = shutil.copytree(policy_folder(tmp_path / "run"), tmp_path / "old")
    assert load_policy(folder)[0].config.embedding_gain == 8
    config = json.loads((folder / "config.json").read_text())
    del config["embedding_gain"]
    (folder / "config.json").write_text(json.dumps(config))
    assert load_policy(folder)[0].config.embedding_gain == 1


@pytest.mark.slow
def test_heads_read_the_oracle_token_of_four_modes_from_the_first_steps(four_modes, tmp_path):
    loss = {}
    for name, more in {"default": [], "unamplified": ["--policy.embedding_gain=1"]}.items():
        flags = [f"--dataset.root={four_modes / 'train'}", f"--output_dir={tmp_path / name}", "--steps=800"]
        flags += ["--policy.token=oracle", "--policy.device=cpu", "--seed=0", *more]
        Training(parse_training_config(flags, None)).run()
        last = (tmp_path / name / "training_log.jsonl").read_text().splitlines()[-1]
        loss[name] = json.loads(last)["flow_loss"]
    assert loss["default"] < 0.6 * loss["unamplified"]
