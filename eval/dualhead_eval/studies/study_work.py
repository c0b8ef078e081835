"""The work that a study lacks: demonstrations recorded, runs trained as sweeps, checkpoints evaluated.

Every stage leaves files that the next call finds: a kill costs what the recorder, the sweep or one evaluation had not
written yet. Work is done in the order of its importance, so that a short budget is spent on what claims rest on.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dualhead_eval.studies.gate_store import GateStore
from dualhead_eval.studies.study_file import StudyDataset
from dualhead_eval.studies.study_plan import StudyEvaluation, StudyPlan, StudyRun


@dataclass(frozen=True)
class Workplace:
    """Where a study's work is done.

    Attributes:
        data: Folder of the datasets, by name.
        runs: Folder of the sweep that trains its runs.
        gates: Folder of its gate files.
        jobs: Groups of runs, or evaluations, at a time.
        stack: Runs that train as one program at most.
        precision: Type in which the velocity fields compute in training.
        show_progress: Whether to draw bars.
    """

    data: Path
    runs: Path
    gates: Path
    jobs: int = 2
    stack: int = 16
    precision: str = "fp32"
    show_progress: bool = True

    def checkpoint(self, run: StudyRun, step: int) -> Path:
        """The policy of a run's checkpoint."""
        return self.runs / run.training_name / "checkpoints" / f"{step:06d}" / "pretrained_model"


def do_missing_work(
    plan: StudyPlan, place: Workplace, say: Callable[[str], object], least_importance: int | None = None
) -> None:
    """Record, train and evaluate what a study's gate files lack.

    Args:
        plan: What is wanted.
        place: Where.
        say: Told what begins.
        least_importance: Leave out what is less important (a larger number); None: do everything.

    Raises:
        ValueError: If a run failed, or the data at hand are not those of the gates that are there.
    """
    store = GateStore(place.gates)
    missing = [
        evaluation
        for evaluation in store.missing(plan)
        if least_importance is None or evaluation.importance <= least_importance
    ]
    if not missing:
        return
    _record_missing(plan, missing, place, say)
    for importance, group in itertools.groupby(missing, key=lambda evaluation: evaluation.importance):
        wanted = list(group)
        untrained = [e for e in wanted if not (place.checkpoint(e.run, e.step) / "config.json").is_file()]
        runs = plan.trainings(evaluation.run for evaluation in untrained)
        if runs:
            say(f"importance {importance}: training {len(runs)} runs")
            _train(runs, place)
        say(f"importance {importance}: evaluating {len(wanted)} checkpoints")
        _evaluate(plan, wanted, place)


def _record_missing(
    plan: StudyPlan, missing: Sequence[StudyEvaluation], place: Workplace, say: Callable[[str], object]
) -> None:
    from dualhead_envs.record import record

    for name in dict.fromkeys(evaluation.run.dataset for evaluation in missing):
        root, dataset = place.data / name, plan.datasets[name]
        if (root / "card.json").is_file():
            continue
        say(f"recording {name} ({dataset.env}) into {root}")
        record(dataset.env, root, progress=place.show_progress, **record_options(dataset))


def record_options(dataset: StudyDataset) -> dict[str, Any]:
    """Arguments with which the recorder makes a dataset."""
    given = dataset.model_dump(exclude={"env"}, exclude_none=True)
    return {name: value for name, value in given.items() if value != {}}


def _train(runs: Sequence[StudyRun], place: Workplace) -> None:
    from dualhead_policy.training.sweep.run_sweep import run_sweep

    manifest = run_sweep(
        [run.sweep_run(place.data) for run in runs],
        place.runs,
        jobs=place.jobs,
        size=place.stack,
        precision=place.precision,
        show_progress=place.show_progress,
    )
    failed = [name for name in (run.name for run in runs) if manifest.runs[name].state == "failed"]
    if failed:
        raise ValueError(f"run {failed[0]} failed: {manifest.runs[failed[0]].error}")


def _evaluate(plan: StudyPlan, wanted: Sequence[StudyEvaluation], place: Workplace) -> None:
    from joblib import Parallel, delayed, parallel_config

    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        disable=not place.show_progress,
        console=_standard_error(),
    )
    jobs = min(place.jobs, len(wanted))
    with bars, parallel_config(backend="loky" if jobs > 1 else "sequential"):
        task = bars.add_task("evaluations", total=len(wanted))
        parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
        for _ in parallel(delayed(_evaluate_one)(plan, evaluation, place) for evaluation in wanted):
            bars.advance(task)


def _evaluate_one(plan: StudyPlan, evaluation: StudyEvaluation, place: Workplace) -> None:
    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    import torch

    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.samplers import open_policy
    from dualhead_eval.studies.study_evaluation import evaluate_study_run
    from dualhead_policy.training.checkpoints import window_origin

    if place.jobs > 1:
        torch.set_num_threads(1)
    folder = place.checkpoint(evaluation.run, evaluation.step)
    origin = window_origin(folder.parent)
    sampler = open_policy(folder, device="cuda" if torch.cuda.is_available() else "cpu")
    evaluate_study_run(
        evaluation,
        plan.bank(evaluation),
        sampler,
        open_conditions(place.data / evaluation.run.dataset / "test"),
        place.gates,
        training_data="" if origin is None else origin.dataset,
        precision=place.precision,
        device=str(sampler.provenance["training"].get("device") or "unknown"),
    )


def _standard_error() -> Any:
    from rich.console import Console

    return Console(stderr=True)
