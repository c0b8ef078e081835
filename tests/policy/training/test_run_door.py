"""What a run reads back (its data's statistics, its log, its training state) is believed only where it agrees."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from dualhead_envs.dataset_frames import read_split
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.checkpoints import last_checkpoint, window_origin
from dualhead_policy.training.dataset_metadata import open_metadata
from dualhead_policy.training.provenance import training_summary
from dualhead_policy.training.trainer import Training
from dualhead_policy.training.training_log import TrainingLog, read_training_log


@pytest.fixture
def split(ring_data, tmp_path):
    return shutil.copytree(ring_data / "train", tmp_path / "train")


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_whole_metadata_are_opened(split):
    assert open_metadata("local/ring", read_split(split)).total_episodes == 256


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda stats: stats["observation.state"].update(mean=[9.0, 9.0]), r"statistics are of other data"),
        (lambda stats: stats["action"].update(std=[0.0] * 8), r"action\.std\[0\] = 0, the data have"),
        (lambda stats: stats["action"].update(max=[1e9] * 8), r"action\.max\[0\]"),
        (lambda stats: stats["action"].update(mean=[0.0] * 3), r"no action\.mean of 8 numbers"),
        (lambda stats: stats.pop("action"), r"no action\.mean"),
        (lambda stats: stats.update(action=[1]), "action"),
    ],
)
def test_statistics_of_other_data_are_refused(split, change, sentence):
    edit(split / "meta" / "stats.json", change)
    with pytest.raises(ValueError, match=sentence) as refusal:
        open_metadata("local/ring", read_split(split))
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize("part", ["stats.json", "tasks.parquet", "episodes"])
def test_metadata_that_are_missing_or_damaged_are_refused(split, part):
    path = split / "meta" / part
    frames = read_split(split)
    files = [path] if path.is_file() else list(path.rglob("*.parquet"))
    for file in files:
        file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(ValueError, match="record the dataset again"):
        open_metadata("local/ring", frames)
    for file in files:
        file.unlink()
    with pytest.raises(FileNotFoundError, match="record the dataset again"):
        open_metadata("local/ring", frames)


GOOD = '{"step": 200, "loss": 1.5, "flow_loss": 1.0, "steps_per_second": 9.0, "residual": {"position_mm": 3.0}}\n'


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ('{"step": 400, "loss": NaN}', "line 2, holds NaN"),
        ('{"step": 400, "loss": "low"}', r"line 2, has loss = 'low', expected a valid number"),
        ('{"step": 100, "loss": 1.0}', "line 2, is of step 100 after step 200"),
        ('{"loss": 1.0}', "line 2, lacks the field 'step'"),
        ("[" * 99_999, "line 2, is nested too deeply"),
        ("torn", "line 2, is truncated or not JSON"),
    ],
)
def test_a_damaged_line_of_the_log_is_refused(tmp_path, line, sentence):
    path = tmp_path / "training_log.jsonl"
    path.write_text(GOOD + line + "\n")
    for reader in (read_training_log, lambda log: TrainingLog(log, 1000)):
        with pytest.raises(ValueError, match=sentence):
            reader(path)


def test_a_torn_last_line_is_what_a_kill_leaves(tmp_path):
    path = tmp_path / "training_log.jsonl"
    path.write_text(GOOD + '{"step": 400, "lo')
    assert [line.step for line in read_training_log(path)] == [200]


@pytest.fixture
def run(trained, tmp_path):
    return shutil.copytree(trained, tmp_path / "run", symlinks=True)


def resume(run):
    return Training(parse_training_config(["--resume=true", f"--output_dir={run}", "--steps=40"], None))


@pytest.mark.parametrize(
    "part",
    ["training_step.json", "optimizer_state.safetensors", "optimizer_param_groups.json", "rng_state.safetensors"],
)
def test_a_damaged_training_state_is_refused(run, part):
    path = last_checkpoint(run) / "training_state" / part
    path.write_bytes(path.read_bytes()[:7])
    with pytest.raises(ValueError, match="training_state is damaged"):
        resume(run)


def test_a_training_state_of_another_step_is_refused(run):
    path = last_checkpoint(run) / "training_state" / "training_step.json"
    edit(path, lambda content: content.update(step=7))
    with pytest.raises(ValueError, match="of step 7, its policy of step 30"):
        resume(run)


def test_an_infinite_deviation_is_refused_on_resuming(run):
    path = last_checkpoint(run) / "pretrained_model" / "policy_preprocessor_step_3_normalizer_processor.safetensors"
    state = load_file(path)
    save_file({name: torch.full_like(values, torch.inf) for name, values in state.items()}, path)
    with pytest.raises(ValueError, match="expected finite numbers"):
        resume(run)


def test_what_a_checkpoint_says_of_its_run_is_checked(run):
    checkpoint = last_checkpoint(run)
    assert training_summary(checkpoint / "pretrained_model")["steps"] == 30
    assert np.isfinite(training_summary(checkpoint / "pretrained_model")["final_loss"])
    edit(checkpoint / "training_state" / "window_source.json", lambda content: content.update(dataset=3))
    with pytest.raises(ValueError, match="dataset = 3, expected a valid string"):
        window_origin(checkpoint)
    edit(checkpoint / "pretrained_model" / "train_config.json", lambda content: content.update(steps="many"))
    with pytest.raises(ValueError, match="steps"):
        training_summary(checkpoint / "pretrained_model")
