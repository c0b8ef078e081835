"""Train several runs at once, one process a core, with one progress bar a run."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import queue
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dualhead_envs.worker_processes import interrupts_kept_from_workers

if TYPE_CHECKING:
    from dualhead_policy.training.trainer import Progress as Report
    from dualhead_policy.training.trainer import Training

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
    too small to share. The processes end with the caller, however it ends.

    Returns:
        The final ``pretrained_model`` folder of every run, by name.

    Raises:
        Exception: Whatever the first failing run raised; the others are finished first.
        ChildProcessError: If a process was ended from outside.
    """
    workers = min(jobs, len(runs))
    context = multiprocessing.get_context("spawn")
    reports = context.Queue()
    # Never written to: the workers see its end when this process is gone, or closes it.
    lifeline, own_end = context.Pipe(duplex=False)
    with (
        ProcessPoolExecutor(
            workers, context, initializer=_begin_worker, initargs=(lifeline, reports, 1 if workers > 1 else None)
        ) as pool,
        _bars(show_progress) as bars,
    ):
        try:
            tasks = {run.name: bars.add_task(run.name, total=None, loss="waiting") for run in runs}
            with interrupts_kept_from_workers():
                futures: dict[str, Future[Path]] = {run.name: pool.submit(_train_one, run) for run in runs}
            while not all(future.done() for future in futures.values()):
                _show(bars, tasks, reports, timeout=REPORT_SECONDS)
            while _show(bars, tasks, reports, timeout=0):
                pass
        except BaseException:
            own_end.close()
            raise
    try:
        return {name: future.result() for name, future in futures.items()}
    except BrokenProcessPool as error:
        raise ChildProcessError(
            "a training process was ended from outside (out of memory?): the last complete checkpoint of every run "
            "stands; repeat the command with --resume=true, and fewer --jobs"
        ) from error


def _bars(show: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("steps"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[loss]}"),
        console=Console(stderr=True),
        disable=not show,
    )


def _show(bars: Progress, tasks: Mapping[str, Any], reports: Any, timeout: float) -> bool:
    """Show the next report, if one comes within ``timeout`` seconds; returns whether one came."""
    try:
        name, step, total, loss = reports.get(timeout=timeout) if timeout else reports.get_nowait()
    except queue.Empty:
        return False
    bars.update(tasks[name], completed=step, total=total, loss=f"loss {loss:.3f}")
    return True


_reports: Any = None


def _begin_worker(lifeline: Any, reports: Any, threads: int | None) -> None:
    """Prepare a training process: its end, its reports, its arithmetic threads."""

    def end_with_parent() -> None:
        multiprocessing.connection.wait([lifeline])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    global _reports
    _reports = reports

    import torch

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    if threads is not None:
        torch.set_num_threads(threads)


def _train_one(run: Run) -> Path:
    from dualhead_policy.training.run import train_run

    @contextmanager
    def follow(training: Training) -> Iterator[Report]:
        last = 0.0

        def report(step: int, loss: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last > REPORT_SECONDS or step == training.cfg.steps:
                last = now
                _reports.put((run.name, step, training.cfg.steps, loss))

        yield report

    with redirect_stdout(None):
        return train_run(run.arguments, run.preset, fresh_paths=run.fresh_paths, follow=follow)
