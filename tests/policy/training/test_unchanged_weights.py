"""Thirty training steps give the weights that they gave before the network became a model of its own.

``weights_of_30_steps.json`` holds the norm of every tensor, computed by commit b258fd0 with the flags below.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from safetensors.torch import load_file

from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.checkpoints import last_checkpoint
from dualhead_policy.training.trainer import Training

NORMS = json.loads(Path(__file__).with_name("weights_of_30_steps.json").read_text())
SIZE = ["--steps=30", "--batch_size=32", "--seed=0", "--policy.velocity_width=32", "--policy.encoder_dim=16"]
RUNS = {
    "ring, independent heads": ("ring_data", ["--policy.source_noise_beta=1"]),
    "ring, latent posterior": ("ring_data", ["--policy.latent=posterior", "--policy.kl_weight=0.1"]),
    "robot, consistency, shared noise, learned token prior": (
        "panda_data",
        [
            "--policy.source_noise_beta=0",
            "--policy.consistency_weight=3",
            "--policy.token=episode",
            "--policy.n_tokens=2",
            "--policy.token_draw=learned",
        ],
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_training_gives_the_weights_of_before(name, request, tmp_path):
    data, flags = RUNS[name]
    root = request.getfixturevalue(data) / "train"
    arguments = [f"--dataset.root={root}", f"--output_dir={tmp_path / 'run'}", "--policy.device=cpu", *SIZE, *flags]
    Training(parse_training_config(arguments, None)).run()
    tensors = load_file(last_checkpoint(tmp_path / "run") / "pretrained_model" / "model.safetensors")
    for tensor, norm in NORMS[name].items():
        assert float(tensors[f"model.{tensor}"].double().norm()) == pytest.approx(norm, rel=1e-4, abs=1e-6), tensor
