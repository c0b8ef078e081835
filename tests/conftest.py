"""A small recorded ring and a briefly trained policy, shared by the tests of the policy and the evaluator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # Before torch is loaded: with a thread per core, tests side by side and their processes wait for each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

#: What the console script `lerobot-train` does, for one set of flags after the other; it never names this package.
LEROBOT_TRAIN = """
import json, sys
from lerobot.scripts.lerobot_train import main
for flags in json.loads(sys.argv[1]):
    sys.argv = ["lerobot-train", *flags]
    main()
"""


@pytest.fixture(scope="session")
def ring_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ring recording with the nullspace representation: 256 training paths, 12 conditions a bank."""
    from dualhead_envs.ring.record import record_ring

    root = tmp_path_factory.mktemp("data") / "ring"
    return record_ring("RotatingRing-v2", root, episodes=256, conditions=12, env_kwargs={"representation": "nullspace"})


@pytest.fixture(scope="session")
def panda_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of BimodalBypass-v2: 4 training pairs, one condition a bank."""
    from dualhead_envs.bypass.record import record_bypass

    root = tmp_path_factory.mktemp("data") / "panda"
    return record_bypass("BimodalBypass-v2", root, pairs=6, workers=1, progress=False)


@pytest.fixture(scope="session")
def trained(ring_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a short training run with an oracle token."""
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.trainer import Training

    output = tmp_path_factory.mktemp("runs") / "oracle"
    cfg = parse_training_config(
        [
            f"--dataset.root={ring_data / 'train'}",
            f"--output_dir={output}",
            "--steps=30",
            "--batch_size=64",
            "--policy.token=oracle",
            "--policy.device=cpu",
            "--policy.velocity_width=64",
        ],
        None,
    )
    Training(cfg).run()
    return output


@pytest.fixture(scope="session")
def lerobot_runs(ring_data: Path, panda_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Output folders of `lerobot-train`: an ACT on the ring, and a Diffusion policy with a past on the robot."""
    folder = tmp_path_factory.mktemp("lerobot")
    common = ["--policy.device=cpu", "--policy.push_to_hub=false", "--num_workers=0", "--env_eval_freq=0"]
    common += ["--dataset.video_backend=pyav", "--batch_size=32", "--seed=0"]
    mapping = "--policy.normalization_mapping=" + json.dumps(dict.fromkeys(["STATE", "ENV", "ACTION"], "MIN_MAX"))
    act = ["--policy.type=act", "--policy.chunk_size=16", "--policy.n_action_steps=16", "--policy.dim_model=32"]
    act += ["--policy.n_heads=4", "--policy.dim_feedforward=64", "--policy.n_encoder_layers=1"]
    act += ["--policy.n_vae_encoder_layers=1", "--policy.latent_dim=4", "--policy.optimizer_lr=1e-3"]
    diffusion = ["--policy.type=diffusion", "--policy.n_obs_steps=2", "--policy.horizon=20", mapping]
    diffusion += ["--policy.n_action_steps=8", "--policy.down_dims=[16,32]", "--policy.drop_n_last_frames=11"]
    diffusion += ["--policy.noise_scheduler_type=DDIM", "--policy.num_inference_steps=3", "--policy.n_groups=4"]
    runs = {"act": (act, ring_data, 150), "diffusion": (diffusion, panda_data, 20)}
    asked = [
        [
            *common, *flags, "--dataset.repo_id=local/data", f"--dataset.root={data / 'train'}",
            f"--output_dir={folder / name}", f"--steps={steps}", f"--save_freq={steps}",
        ]
        for name, (flags, data, steps) in runs.items()
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", LEROBOT_TRAIN, json.dumps(asked)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return {name: folder / name for name in runs}
