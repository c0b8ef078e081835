"""Stacked training on an NVIDIA GPU: losses against the CPU's, and the rate against the number of stacked runs.

    uv run python benchmarks/stacked_training_cuda.py
    uv run python benchmarks/stacked_training_cuda.py --dataset data/v2/train --runs 1 4 16 64 96 256 --precision fp32

Steps include the draws, which other processes make ahead, and their way to the GPU. Seeds differ between the runs;
nothing else does. Prints the largest difference of the first steps' losses from the CPU's too.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import torch

#: Steps whose losses are held against the CPU's.
COMPARED = 20
#: Seconds that the paper's authors report for one run.
PAPER_SECONDS = 355


def build(root: str, output: Path, runs: int, device: str, flags: list[str]) -> list[Any]:
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.array_store import ArrayStore
    from dualhead_policy.training.trainer import Training

    store, trainings = ArrayStore(output / ".windows"), []
    for seed in range(runs):
        places = [f"--dataset.root={root}", f"--output_dir={output / str(seed)}", f"--seed={seed}"]
        budget = ["--steps=50000", "--batch_size=128", f"--policy.device={device}"]
        training = Training(parse_training_config([*places, *budget, *flags], None))
        training.share_windows(store)
        trainings.append(training)
    return trainings


def seconds_per_step(stack: Any, steps: int) -> float:
    stack.updates(steps)
    torch.cuda.synchronize()
    began = time.perf_counter()
    stack.updates(steps)
    torch.cuda.synchronize()
    return (time.perf_counter() - began) / steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", help="training split (default: BimodalBypass-v2, 6 pairs, recorded for this)")
    parser.add_argument("--runs", type=int, nargs="+", default=[1, 4, 16, 64, 96, 256], help="numbers of stacked runs")
    parser.add_argument("--precision", nargs="+", default=["fp32", "tf32", "bf16"], choices=["fp32", "tf32", "bf16"])
    parser.add_argument("--steps", type=int, default=100, help="steps that are timed (default: 100)")
    parser.add_argument("--flag", action="append", default=[], help="flag of `dualhead train` for every run")
    args = parser.parse_args()
    if not torch.cuda.is_available():
        parser.exit(2, "no CUDA device: run this where `nvidia-smi` shows one\n")
    from rich.console import Console
    from rich.table import Table

    from dualhead_policy.quiet import quiet_libraries
    from dualhead_policy.training.stacked.stacked_training import StackedTraining

    quiet_libraries()
    console = Console(width=120)
    with tempfile.TemporaryDirectory() as folder:
        if args.dataset is None:
            from dualhead_envs.bypass.record import record_bypass

            data = record_bypass("BimodalBypass-v2", Path(folder) / "v2", pairs=6, workers=1, progress=False)
            args.dataset = str(data / "train")
        losses = []
        for device in ("cpu", "cuda"):
            stack = StackedTraining(build(args.dataset, Path(folder) / device, 2, device, args.flag))
            losses.append(stack.updates(COMPARED).cpu())
            stack.close()
        difference = ((losses[1] - losses[0]).abs() / losses[0].abs()).max()
        console.print(f"losses of {COMPARED} steps: at most {difference:.1e} (relative) from the CPU's")
        table = Table(title=f"{torch.cuda.get_device_name()}, batch 128", title_justify="left")
        for column in ("runs", "type", "ms/step", "run-steps/s", "50,000 steps", "x paper", "peak GiB"):
            table.add_column(column, justify="right")
        trainings = build(args.dataset, Path(folder) / "runs", max(args.runs), "cuda", args.flag)
        for precision in args.precision:
            for runs in args.runs:
                torch.cuda.reset_peak_memory_stats()
                stack = StackedTraining(trainings[:runs], precision=precision)
                seconds = seconds_per_step(stack, args.steps)
                stack.close()
                table.add_row(
                    str(runs), precision, f"{1000 * seconds:.2f}", f"{runs / seconds:,.0f}",
                    f"{50_000 * seconds / 60:.1f} min", f"{PAPER_SECONDS * runs / (50_000 * seconds):.0f}",
                    f"{torch.cuda.max_memory_allocated() / 2**30:.2f}",
                )  # fmt: skip
        console.print(table)


if __name__ == "__main__":
    main()
