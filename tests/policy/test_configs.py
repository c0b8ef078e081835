"""Every YAML in configs/ builds the policy that its name says, and trains."""

from __future__ import annotations

from pathlib import Path

import draccus
import pytest
import torch
import yaml
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from dualhead_policy import DualheadConfig
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training

FOLDER = Path(__file__).parents[2] / "configs"
FILES = sorted(FOLDER.rglob("*.yaml"))


def identity(path):
    return str(path.relative_to(FOLDER).with_suffix(""))


def build(path, panda_data, output, *more):
    flags = [f"--config_path={path}", f"--dataset.root={panda_data / 'train'}", f"--output_dir={output}"]
    return parse_training_config([*flags, "--policy.device=cpu", *more], None)


@pytest.fixture(scope="module")
def metadata(panda_data):
    return LeRobotDatasetMetadata("local/panda", root=panda_data / "train")


@pytest.mark.parametrize("path", FILES, ids=identity)
def test_every_file_builds_a_policy_with_the_fields_that_it_names(metadata, path):
    """Decoded as LeRobot decodes it, without its command line, which takes seconds to set up."""
    content = yaml.safe_load(path.read_text())
    assert set(content) == {"policy", "steps", "batch_size", "save_freq", "env_eval_freq"}
    fields = {name: value for name, value in content["policy"].items() if name != "type"}
    policy = make_policy(draccus.decode(DualheadConfig, {**fields, "device": "cpu"}), ds_meta=metadata)
    for name, value in fields.items():
        assert getattr(policy.config, name) == value, name
    action = torch.zeros(4, 16, 17)
    token = torch.zeros(4, dtype=torch.int64) if policy.model.tokens is not None else None
    assert policy.compute_loss(torch.zeros(4, 42), action, token)[0].isfinite()


def test_a_file_trains(panda_data, tmp_path):
    cfg = build(FOLDER / "v2" / "I_episode_token_learned.yaml", panda_data, tmp_path / "run")
    assert (cfg.steps, cfg.batch_size) == (50_000, 128)
    training = Training(cfg)
    loss, flow = training.update(training.source.batch(0))
    assert 0 < flow < loss < 100


def test_the_tables_rows_are_all_there():
    rows = {f"{path.parent.name}/{path.stem.split('_')[0]}" for path in FILES}
    assert {f"v2/{letter}" for letter in "ABCDEFGHIJK"} <= rows
    assert {f"v3/{letter}" for letter in "ABDGHK"} <= rows
    assert {f"v2_three_ways/{letter}" for letter in "ABGHK"} <= rows


@pytest.mark.parametrize("path", sorted((FOLDER / "v2_three_ways").glob("*.yaml")), ids=identity)
def test_three_ways_differ_from_two_in_the_number_of_tokens_alone(path):
    three, two = (yaml.safe_load((FOLDER / folder / path.name).read_text()) for folder in ("v2_three_ways", "v2"))
    assert three["policy"].pop("n_tokens", 3) == 3
    assert two["policy"].pop("n_tokens", 2) == 2
    assert three == two


def test_flags_and_presets_override_a_file(panda_data, tmp_path):
    path = FOLDER / "v2" / "H_episode_token_uniform.yaml"
    cfg = build(path, panda_data, tmp_path / "run", "--steps=7", "--policy.token_draw=learned")
    assert (cfg.steps, cfg.policy.token_draw, cfg.policy.token) == (7, "learned", "episode")


def test_a_key_that_does_not_exist_is_refused(panda_data, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("policy:\n  type: dualhead\n  colour: red\n")
    with pytest.raises(ValueError, match="colour"):
        build(path, panda_data, tmp_path / "run")
