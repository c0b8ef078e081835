"""Train several runs at once, one process a core, with one progress bar a run."""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

#: Seconds between two reports of a training process.
REPORT_SECONDS = 0.25


@dataclass(frozen=True)
class Run:
    """One training run: a name for its bar, and the flags of ``dualhead train``."""

    name: str
    arguments: Sequence[str]
    preset: str | None = None
    fresh_paths: bool = False


def train_runs(runs: Sequence[Run], *, jobs: int, show_progress: bool = True) -> dict[str, Path]:
    """Train ``runs``, ``jobs`` at a time.

    Each run has a process of its own with one arithmetic thread when several run at once: these networks are
    too small to share.

    Returns:
        The final ``pretrained_model`` folder of every run, by name.

    Raises:
        Exception: Whatever the first failing run raised; the others are finished first.
    """
    threads = 1 if min(jobs, len(runs)) > 1 else None
    context = multiprocessing.get_context("spawn")
    with (
        context.Manager() as manager,
        ProcessPoolExecutor(min(jobs, len(runs)), mp_context=context) as pool,
        Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("steps"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[loss]}"),
            console=Console(stderr=True),
            disable=not show_progress,
        ) as bars,
    ):
        reports = manager.Queue()
        tasks = {run.name: bars.add_task(run.name, total=None, loss="waiting") for run in runs}
        futures: dict[str, Future[Path]] = {run.name: pool.submit(_train_one, run, threads, reports) for run in runs}
        while not all(future.done() for future in futures.values()):
            _show(bars, tasks, reports, timeout=REPORT_SECONDS)
        while not reports.empty():
            _show(bars, tasks, reports, timeout=0)
    return {name: future.result() for name, future in futures.items()}


def _show(bars: Progress, tasks: Mapping[str, Any], reports: Any, timeout: float) -> None:
    try:
        name, step, total, loss = reports.get(timeout=timeout) if timeout else reports.get_nowait()
    except queue.Empty:
        return
    bars.update(tasks[name], completed=step, total=total, loss=f"loss {loss:.3f}")


def _train_one(run: Run, threads: int | None, reports: Any) -> Path:
    import contextlib
    import time

    import torch

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    if threads is not None:
        torch.set_num_threads(threads)
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.trainer import Training

    with contextlib.redirect_stdout(None):
        training = Training(parse_training_config(run.arguments, run.preset), fresh_paths=run.fresh_paths)
    last = 0.0
    parent = multiprocessing.parent_process()

    def report(step: int, loss: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > REPORT_SECONDS or step == training.cfg.steps:
            last = now
            if parent is not None and not parent.is_alive():
                raise SystemExit("the command that started this training is gone")
            reports.put((run.name, step, training.cfg.steps, loss))

    return training.run(report)
