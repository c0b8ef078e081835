"""Train what a sweep lacks: groups through joblib, the manifest kept, progress shown."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dualhead_envs.recording.claim import claimed
from dualhead_envs.worker_processes import interrupts_kept_from_workers
from dualhead_policy.training.sweep.group_training import Group, train_group
from dualhead_policy.training.sweep.grouping import plan_runs
from dualhead_policy.training.sweep.manifest import Manifest, continue_manifest, read_manifest
from dualhead_policy.training.sweep.sweep_file import SweepRun
from dualhead_policy.training.sweep.workers import workers

#: Seconds between two looks at how far the groups are.
LOOK_SECONDS = 1.0


def run_sweep(
    runs: Sequence[SweepRun],
    output: Path,
    *,
    jobs: int,
    size: int,
    precision: str,
    backend: str = "local",
    address: str | None = None,
    show_progress: bool = True,
) -> Manifest:
    """Train every run that is not finished yet.

    Args:
        runs: The runs of the sweep's file.
        output: The sweep's folder.
        jobs: Groups at a time.
        size: Largest number of runs in a group.
        precision: ``"fp32"``, ``"tf32"`` or ``"bf16"``.
        backend, address: Where the groups train; see :mod:`.workers`.
        show_progress: Whether to draw a bar.

    Returns:
        The manifest at the end.

    Raises:
        BlockingIOError: If another command trains the sweep.
        ValueError: If a configuration is wrong, or a run was begun with another.
    """
    output = output.resolve()
    output.parent.mkdir(parents=True, exist_ok=True)
    planned = plan_runs(runs, output, precision)
    by_name = {run.name: run for run in runs}
    with claimed(output.with_name(f".{output.name}.sweep"), output):
        manifest = continue_manifest(read_manifest(output), planned, size=size, jobs=jobs).as_found(output)
        manifest.write(output)
        groups = []
        for name, members in manifest.groups().items():
            todo = tuple(
                by_name[member] for member in members if member in by_name and manifest.runs[member].state != "finished"
            )
            if todo:
                groups.append(Group(name, output, todo, precision, 1 if jobs > 1 else None))
        with workers(backend, address), _shown(manifest, groups, show_progress):
            if not groups:
                return manifest
            parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="all")
            with interrupts_kept_from_workers():
                outcomes = parallel(delayed(train_group)(group) for group in groups)
            for outcome in outcomes:
                manifest = manifest.updated({name: {"error": None} | change for name, change in outcome.items()})
                manifest.write(output)
    return manifest


@contextmanager
def _shown(manifest: Manifest, groups: Sequence[Group], show: bool) -> Iterator[None]:
    """One bar over all run-steps of the sweep, fed by the groups' progress files."""
    for group in groups:
        group.progress_file.unlink(missing_ok=True)
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("run-steps"),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=Console(stderr=True),
        disable=not show,
    )
    total = sum(record.steps for record in manifest.runs.values())
    done = sum(record.steps for record in manifest.runs.values() if record.state == "finished")
    ended = threading.Event()
    with bars:
        task = bars.add_task(f"{len(manifest.unfinished())} runs to train", total=total, completed=done)

        def look() -> None:
            while not ended.wait(LOOK_SECONDS):
                steps = [_progress(group) for group in groups]
                bars.update(task, completed=done + sum(steps))

        watcher = threading.Thread(target=look, daemon=True)
        watcher.start()
        try:
            yield
            bars.update(task, completed=total)
        finally:
            ended.set()
            watcher.join()


def _progress(group: Group) -> int:
    try:
        content: dict[str, Any] = json.loads(group.progress_file.read_text())
    except (OSError, ValueError):
        return 0
    return int(content["step"]) * len(group.runs)
