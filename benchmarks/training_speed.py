"""Training steps a second: `dualhead train` against `lerobot-train`, same dataset, policy and machine, in one run.

    uv run python benchmarks/training_speed.py

Records a ring of 3,000 paths into a temporary folder, runs both trainers as real processes, and prints each one's
data and update time per step after warm-up, the ratios, and the share of this machine's own matrix-product rate
that `dualhead train` reaches.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from dualhead_policy.quiet import quiet_libraries

WORKERS = (0, 2, 4)
BATCH = 128


def command(name: str) -> str:
    return str(Path(sys.executable).with_name(name))


def run(arguments: list[str]) -> str:
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)} failed:\n{done.stderr[-3000:]}")
    return done.stdout + done.stderr


def lerobot_seconds(data: Path, output: Path, workers: int, steps: int, log_freq: int) -> tuple[float, float]:
    """(data, update) seconds a step of `lerobot-train`, the first logging window left out as warm-up."""
    log = run(
        [
            command("lerobot-train"), "--policy.type=dualhead", "--dataset.repo_id=local/ring",
            f"--dataset.root={data / 'train'}", f"--output_dir={output}", f"--batch_size={BATCH}",
            f"--steps={steps}", f"--log_freq={log_freq}", f"--num_workers={workers}", "--save_checkpoint=false",
            "--env_eval_freq=0", "--policy.device=cpu",
        ]
    )  # fmt: skip
    windows = re.findall(r"updt_s:(\S+) data_s:(\S+)", log)[1:]
    update, data_time = (sum(float(pair[i]) for pair in windows) / len(windows) for i in (0, 1))
    return data_time, update


def dualhead_seconds(data: Path, output: Path, steps: int) -> float:
    """Seconds a step of `dualhead train` (data and update together), the first 200 steps left out."""
    run(
        [
            command("dualhead"), "train", f"--dataset.root={data / 'train'}", f"--output_dir={output}",
            f"--batch_size={BATCH}", f"--steps={steps}", "--save_freq=0", "--policy.device=cpu",
        ]
    )  # fmt: skip
    lines = [json.loads(line) for line in (output / "training_log.jsonl").read_text().splitlines()][1:]
    return sum(1 / line["steps_per_second"] for line in lines) / len(lines)


def matrix_product_rate(seconds: float = 2.0) -> float:
    """FLOP/s of this machine's float32 matrix product, 1024 x 1024, with torch's threads."""
    a, b = torch.randn(1024, 1024), torch.randn(1024, 1024)
    for _ in range(5):
        a @ b
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        a @ b
        count += 1
    return count * 2 * 1024**3 / (time.perf_counter() - start)


def flops_a_step(data: Path, output: Path) -> int:
    """Floating-point operations of one training step (forward and backward), counted by torch."""
    from torch.utils.flop_counter import FlopCounterMode

    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.trainer import Training

    flags = [f"--dataset.root={data / 'train'}", f"--output_dir={output}", "--policy.device=cpu"]
    training = Training(parse_training_config(flags, None))
    with FlopCounterMode(display=False) as counter:
        training.update(training.source.batch(0))
    return counter.get_total_flops()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1000, help="steps of dualhead train (default: 1000)")
    parser.add_argument("--lerobot-steps", type=int, default=60, help="steps of lerobot-train (default: 60)")
    args = parser.parse_args()
    quiet_libraries()
    os.environ["OMP_NUM_THREADS"] = str(torch.get_num_threads())
    console = Console(width=110)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        run([command("dualhead"), "record", "--env", "RotatingRing-v2", "--root", str(root / "ring"), "--no-progress"])
        ours = dualhead_seconds(root / "ring", root / "ours", args.steps)
        theirs = {
            workers: lerobot_seconds(
                root / "ring", root / f"theirs-{workers}", workers, args.lerobot_steps, args.lerobot_steps // 3
            )
            for workers in WORKERS
        }
        flops = flops_a_step(root / "ring", root / "count")
    rate = matrix_product_rate()

    table = Table(title=f"Training on {torch.get_num_threads()} threads, batch {BATCH}", title_justify="left")
    for name in ("trainer", "data ms", "update ms", "steps/s", "dualhead train is faster by"):
        table.add_column(name, justify="left" if name == "trainer" else "right")
    table.add_row("dualhead train", "", f"{ours * 1e3:.1f}", f"{1 / ours:.1f}", "")
    for workers, (data_time, update) in theirs.items():
        total = data_time + update
        table.add_row(
            f"lerobot-train, {workers} workers",
            f"{data_time * 1e3:.1f}",
            f"{update * 1e3:.1f}",
            f"{1 / total:.2f}",
            f"{total / ours:.1f} x",
        )
    console.print(table)
    best = min(sum(times) for times in theirs.values())
    console.print(f"against the best of lerobot-train's loader settings: {best / ours:.1f} x")
    console.print(
        f"arithmetic: {flops / 1e6:.0f} MFLOP a step, {flops / ours / 1e9:.1f} GFLOP/s, "
        f"{flops / ours / rate:.0%} of this machine's matrix product ({rate / 1e9:.1f} GFLOP/s, 1024 x 1024, float32)"
    )


if __name__ == "__main__":
    main()
