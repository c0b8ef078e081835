"""Stacked training against one process per core, on the same runs and machine, in interleaved rounds.

    uv run python benchmarks/stacked_training.py
    uv run python benchmarks/stacked_training.py --dataset data/v2/train --runs 16 --rounds 5

Every round times, one after the other: single runs, one in each of two processes; the same runs stacked in two
processes with one thread each, in float32 and in bfloat16; all of them stacked in one process with two threads; and
large float32 matrix products in two processes. Prints run-steps per second of wall clock and of processor time
(the second is what counts where other people use the machine too), the ratios to the single runs' as medians over the
rounds, and the share of the products' rate that the model's own multiply-adds reach.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import platform
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

CORES = 2
ROWS = {
    "single runs, a process per core": ("single", CORES, 1),
    "stacked fp32, a process per core": ("fp32", CORES, 1),
    "stacked bf16, a process per core": ("bf16", CORES, 1),
    "stacked fp32, one process, two threads": ("fp32", 1, CORES),
}


def build(root: str, output: str, seeds: range, flags: list[str]) -> list[Any]:
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.trainer import Training

    trainings = []
    for seed in seeds:
        places = [f"--dataset.root={root}", f"--output_dir={output}/{seed}", f"--seed={seed}"]
        trainings.append(
            Training(parse_training_config([*places, "--steps=1000000", "--policy.device=cpu", *flags], None))
        )
    return trainings


def work(
    kind: str, threads: int, root: str, output: str, seeds: range, flags: list[str], barrier: Any, seconds: float,
    results: Any,
) -> None:  # fmt: skip
    """Make steps for a while in every round, in step with the other processes; sends (run-steps, wall, CPU seconds)."""
    import torch

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    torch.set_num_threads(threads)
    if kind == "dense":
        left, right = torch.randn(1024, 1024), torch.randn(1024, 1024)

        def step() -> int:
            left @ right
            return 1
    elif kind == "single":
        training = build(root, output, seeds[:1], flags)[0]

        def step() -> int:
            training.update(training.source.batch(training.step))
            return 1
    else:
        from dualhead_policy.training.array_store import ArrayStore
        from dualhead_policy.training.stacked.freed_memory import keep_freed_memory
        from dualhead_policy.training.stacked.stacked_training import StackedTraining

        keep_freed_memory()
        trainings = build(root, output, seeds, flags)
        store = ArrayStore(Path(output) / ".windows")
        for training in trainings:
            training.share_windows(store)
        stack = StackedTraining(trainings, precision=kind)

        def step() -> int:
            stack.update()
            return len(trainings)

    for _ in range(3):
        step()
    while True:
        barrier.wait()  # our turn, or the end
        if results["stop"]:
            return
        made, wall, cpu = 0, time.perf_counter(), time.process_time()
        while time.perf_counter() - wall < seconds:
            made += step()
        results[os.getpid()] = (made, time.perf_counter() - wall, time.process_time() - cpu)
        barrier.wait()  # done


class Row:
    """The processes of one row, waiting for their turn."""

    def __init__(self, manager: Any, kind: str, processes: int, threads: int, args: argparse.Namespace, output: str):
        self.results = manager.dict(stop=False)
        self.barrier = manager.Barrier(processes + 1)
        context = multiprocessing.get_context("spawn")
        share = args.runs // processes
        self.processes = [
            context.Process(
                target=work,
                args=(
                    kind, threads, args.dataset, f"{output}/{kind}-{threads}-{index}",
                    range(index * share, (index + 1) * share), args.flag, self.barrier, args.seconds, self.results,
                ),
            )
            for index in range(processes)
        ]  # fmt: skip
        for process in self.processes:
            process.start()

    def turn(self) -> tuple[float, float]:
        """Run-steps per second of wall clock, over all processes, and per second of processor time."""
        self.barrier.wait()
        self.barrier.wait()
        own = [value for key, value in self.results.items() if key != "stop"]
        per_cpu = sum(made for made, _, _ in own) / sum(cpu for _, _, cpu in own)
        return sum(made / wall for made, wall, _ in own), per_cpu

    def stop(self) -> None:
        self.results["stop"] = True
        self.barrier.wait()
        for process in self.processes:
            process.join()


def multiply_adds(args: argparse.Namespace, output: str) -> int:
    """Floating-point operations of one run's step (two per multiply-add), counted by torch."""
    from torch.utils.flop_counter import FlopCounterMode

    training = build(args.dataset, output, range(1), args.flag)[0]
    batch = training.source.batch(0)
    with FlopCounterMode(display=False) as counter:
        training.update(batch)
    return counter.get_total_flops()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", help="training split (default: BimodalBypass-v2, 6 pairs, recorded for this)")
    parser.add_argument("--runs", type=int, default=16, help="runs in all (default: 16)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds (default: 5)")
    parser.add_argument("--seconds", type=float, default=3.0, help="seconds per row and round (default: 3)")
    parser.add_argument("--flag", action="append", default=[], help="flag of `dualhead train` for every run")
    args = parser.parse_args()
    from rich.console import Console
    from rich.table import Table

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    with tempfile.TemporaryDirectory() as folder, multiprocessing.Manager() as manager:
        if args.dataset is None:
            from dualhead_envs.bypass.record import record_bypass

            data = record_bypass("BimodalBypass-v2", Path(folder) / "v2", pairs=6, workers=1, progress=False)
            args.dataset = str(data / "train")
        flops = multiply_adds(args, f"{folder}/count")
        rows = {name: Row(manager, *setting, args, folder) for name, setting in ROWS.items()}
        rows["dense"] = Row(manager, "dense", CORES, 1, args, folder)
        rounds = [{name: row.turn() for name, row in rows.items()} for _ in range(args.rounds)]
        for row in rows.values():
            row.stop()
    dense = [2 * 1024**3 * measured["dense"][1] for measured in rounds]
    table = Table(title=f"{args.runs} runs, {flops / 1e6:.0f} MFLOP a run-step", title_justify="left")
    for column in ("", "run-steps/s", "x single", "run-steps/CPU-s", "x single", "of dense fp32"):
        table.add_column(column, justify="left" if not column else "right")
    for name in ROWS:
        wall, cpu = (statistics.median(measured[name][i] for measured in rounds) for i in (0, 1))
        first = next(iter(ROWS))
        ratios = [statistics.median(measured[name][i] / measured[first][i] for measured in rounds) for i in (0, 1)]
        share = statistics.median(
            flops * measured[name][1] / rate for measured, rate in zip(rounds, dense, strict=True)
        )
        table.add_row(name, f"{wall:.0f}", f"{ratios[0]:.2f}", f"{cpu:.0f}", f"{ratios[1]:.2f}", f"{share:.0%}")
    console = Console(width=120)
    console.print(table)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    console.print(
        f"dense fp32: {statistics.median(dense) / 1e9:.0f} GFLOP/s per core (1024 x 1024); "
        f"{os.cpu_count()} cores of {platform.processor() or platform.machine()}, load average {load}"
    )


if __name__ == "__main__":
    main()
