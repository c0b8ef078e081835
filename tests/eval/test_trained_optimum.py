"""Trained networks against what the population optimum of the ring implies. Minutes; ``uv run pytest -m slow``."""

from __future__ import annotations

import pytest

from dualhead_eval.cli import main
from dualhead_eval.gate.file import read_gate
from dualhead_eval.statistics.run_summary import summarise_run

pytestmark = pytest.mark.slow


def test_a_latent_that_is_independent_of_the_data_does_not_coordinate_the_heads(tmp_path):
    """lem:zblind: at the optimum no velocity depends on the latent, so that rho is 0, here within the TOST band."""
    data, run, gate = tmp_path / "ring", tmp_path / "run", tmp_path / "D.gate.json"
    assert main(["record", "--env", "RotatingRing-v2", "--representation", "nullspace", "--root", str(data)]) == 0
    flags = [f"--dataset.root={data / 'train'}", f"--output_dir={run}", "--policy.latent=prior", "--steps=3000"]
    assert main(["train", *flags, "--policy.device=cpu"]) == 0
    assert main(["evaluate", "--policy", str(run), "--dataset", str(data / "test"), "--output", str(gate)]) == 0
    summary = summarise_run(read_gate(gate))
    assert summary.valid_rate >= 0.95
    assert summary.equivalence.margin == 0.02
    assert summary.equivalence.equivalent
