"""Every YAML in configs/ builds the policy that its name says, and trains."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training

FOLDER = Path(__file__).parents[2] / "configs"
FILES = sorted(FOLDER.rglob("*.yaml"))


def identity(path):
    return str(path.relative_to(FOLDER).with_suffix(""))


def build(path, panda_data, output, *more):
    flags = [f"--config_path={path}", f"--dataset.root={panda_data / 'train'}", f"--output_dir={output}"]
    return parse_training_config([*flags, "--policy.device=cpu", *more], None)


@pytest.mark.parametrize("path", FILES, ids=identity)
def test_every_file_trains_a_policy_with_the_fields_that_it_names(panda_data, tmp_path, path):
    cfg = build(path, panda_data, tmp_path / "run")
    assert (cfg.steps, cfg.batch_size) == (50_000, 128)
    training = Training(cfg)
    config = training.policy.config
    for name, value in yaml.safe_load(path.read_text())["policy"].items():
        assert getattr(config, name) == value, name
    assert 0 < training.update(training.source.batch(0)) < 1e4


def test_the_tables_rows_are_all_there():
    rows = {identity(path).split("_")[0] for path in FILES}
    assert {f"v2/{letter}" for letter in "ABCDEFGHIJK"} <= rows
    assert {f"v3/{letter}" for letter in "ABDGHK"} <= rows


def test_flags_and_presets_override_a_file(panda_data, tmp_path):
    path = FOLDER / "v2" / "H_episode_token_uniform.yaml"
    cfg = build(path, panda_data, tmp_path / "run", "--steps=7", "--policy.token_draw=learned")
    assert (cfg.steps, cfg.policy.token_draw, cfg.policy.token) == (7, "learned", "episode")


def test_a_key_that_does_not_exist_is_refused(panda_data, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("policy:\n  type: dualhead\n  colour: red\n")
    with pytest.raises(ValueError, match="colour"):
        build(path, panda_data, tmp_path / "run")
