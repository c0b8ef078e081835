"""A small recorded ring and a briefly trained policy, shared by the tests of the policy and the evaluator."""

from __future__ import annotations

from pathlib import Path

import pytest


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
