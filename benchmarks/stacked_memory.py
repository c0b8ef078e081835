"""Peak memory of a group of stacked runs beyond its dataset.

    uv run python benchmarks/stacked_memory.py --dataset data/v2/train --runs 16

Prints the process's largest resident size while it trains, less that of one process that has imported the same
libraries and holds the dataset's windows.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
from pathlib import Path


def peak_gib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def resident_gib() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", required=True, help="training split")
    parser.add_argument("--runs", type=int, default=16, help="runs of the group (default: 16)")
    parser.add_argument("--steps", type=int, default=3, help="steps to make (default: 3)")
    args = parser.parse_args()
    import torch

    from dualhead_policy.quiet import quiet_libraries
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.array_store import ArrayStore
    from dualhead_policy.training.stacked.freed_memory import keep_freed_memory
    from dualhead_policy.training.stacked.stacked_training import StackedTraining
    from dualhead_policy.training.trainer import Training

    quiet_libraries()
    keep_freed_memory()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        store, trainings, alone = ArrayStore(Path(folder) / ".windows"), [], 0.0
        for seed in range(args.runs):
            places = [f"--dataset.root={args.dataset}", f"--output_dir={folder}/{seed}", f"--seed={seed}"]
            budget = ["--steps=1000", "--batch_size=128", "--policy.device=cpu"]
            training = Training(parse_training_config([*places, *budget], None))
            training.share_windows(store)
            trainings.append(training)
            alone = alone or resident_gib()
        built = peak_gib()
        stack = StackedTraining(trainings)
        for _ in range(args.steps):
            stack.update()
        print(f"one run built: {alone:.2f} GiB resident; {args.runs} runs built: peak {built:.2f} GiB")
        peak = peak_gib()
        print(f"{args.runs} runs training: peak {peak:.2f} GiB, {peak - alone:.2f} GiB beyond one built run")


if __name__ == "__main__":
    main()
