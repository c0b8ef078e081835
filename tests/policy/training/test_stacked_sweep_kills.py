"""A sweep that is killed again and again ends with the weights of one that was left alone, each run trained once."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from safetensors.torch import load_file

from dualhead_policy.training.checkpoints import last_checkpoint
from dualhead_policy.training.sweep.manifest import read_manifest

KILLS = 30
FLAGS = {
    "steps": 1500, "save_freq": 100, "batch_size": 32, "policy.device": "cpu", "policy.velocity_width": 32,
    "policy.encoder_dim": 16,
}  # fmt: skip


def write_sweep(folder: Path, ring_data: Path, name: str) -> Path:
    content = {
        "output": str(folder / name),
        "datasets": {"ring": str(ring_data / "train")},
        "configurations": [
            {"name": "A"},
            {"name": "G", "flags": {"policy.consistency_weight": 1}},
            {"name": "K", "flags": {"policy.token": "oracle"}},
        ],
        "seeds": [0, 1, 2, 3],
        "flags": FLAGS,
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def begin(path: Path) -> subprocess.Popen[str]:
    command = Path(sys.executable).with_name("dualhead")
    return subprocess.Popen(
        [command, "sweep", path, "--no-progress"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip


def finished_checkpoints(output: Path) -> dict[str, int]:
    """When the model of every finished run was written."""
    manifest = read_manifest(output)
    if manifest is None:
        return {}
    done = (name for name, record in manifest.as_found(output).runs.items() if record.state == "finished")
    return {
        name: (last_checkpoint(output / name) / "pretrained_model" / "model.safetensors").stat().st_mtime_ns
        for name in done
    }


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_a_sweep_killed_thirty_times_ends_as_if_left_alone(ring_data, tmp_path):
    whole, cut = (write_sweep(tmp_path, ring_data, name) for name in ("whole", "cut"))
    started = time.monotonic()
    process = begin(whole)
    assert process.wait() == 0, process.stderr.read()
    seconds = time.monotonic() - started
    rng = random.Random(0)
    kills, seen = 0, {}
    while True:
        process = begin(cut)
        wait = rng.uniform(0.2, 0.6) * seconds if kills < KILLS else None
        try:
            process.wait(wait)
            assert process.returncode == 0, process.stderr.read()
        except subprocess.TimeoutExpired:
            process.send_signal(rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM]))
            process.wait()
            kills += 1
        now = finished_checkpoints(tmp_path / "cut")
        assert {name: now[name] for name in seen} == seen, "a finished run was trained again"
        seen = now
        if process.returncode == 0:
            break
    assert len(seen) == 12
    for name in seen:
        one, other = (
            load_file(last_checkpoint(tmp_path / folder / name) / "pretrained_model" / "model.safetensors")
            for folder in ("whole", "cut")
        )
        assert all(bool((one[key] == other[key]).all()) for key in one), name
