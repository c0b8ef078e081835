"""The work that a study lacks: demonstrations recorded, runs trained as sweeps, checkpoints evaluated and driven.

Every stage leaves files that the next call finds: a kill costs what the recorder, the sweep or one evaluation had not
written yet. Work is done in the order of its importance, so that a short budget is spent on what claims rest on.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dualhead_eval.studies.closed_loop_store import ClosedLoopStore
from dualhead_eval.studies.gate_store import GateStore
from dualhead_eval.studies.study_file import StudyDataset
from dualhead_eval.studies.study_plan import LOOP_SUFFIX, StudyEvaluation, StudyLoop, StudyPlan, StudyRun


@dataclass(frozen=True)
class Workplace:
    """Where a study's work is done.

    Attributes:
        data: Folder of the datasets, by name.
        runs: Folder of the sweep that trains its runs.
        gates: Folder of its gate files.
        closed_loops: Folder of its closed loops' outcomes.
        jobs: Groups of runs, or evaluations, at a time.
        stack: Runs that train as one program at most.
        precision: Type in which the velocity fields compute in training.
        show_progress: Whether to draw bars.
    """

    data: Path
    runs: Path
    gates: Path
    closed_loops: Path
    jobs: int = 2
    stack: int = 16
    precision: str = "fp32"
    show_progress: bool = True

    def checkpoint(self, run: StudyRun, step: int) -> Path:
        """The policy of a run's checkpoint."""
        return self.runs / run.training_name / "checkpoints" / f"{step:06d}" / "pretrained_model"

    def has(self, run: StudyRun, step: int) -> bool:
        """Whether a run's checkpoint is there."""
        return (self.checkpoint(run, step) / "config.json").is_file()

    def recording(self, loop: StudyLoop) -> Path:
        """Where a closed loop is recorded."""
        return self.runs / "closed_loops" / loop.file.parent / loop.file.name.removesuffix(LOOP_SUFFIX)


def do_missing_work(
    plan: StudyPlan, place: Workplace, say: Callable[[str], object], least_importance: int | None = None
) -> None:
    """Record, train, evaluate and drive what a study's results lack.

    Args:
        plan: What is wanted.
        place: Where.
        say: Told what begins.
        least_importance: Leave out what is less important (a larger number); None: do everything.

    Raises:
        ValueError: If a run failed, or the data at hand are not those of the gates that are there.
    """
    missing, undriven = GateStore(place.gates).missing(plan), ClosedLoopStore(place.closed_loops).missing(plan)
    levels = sorted({one.importance for one in missing} | {one.importance for one in undriven})
    for importance in levels:
        if least_importance is not None and importance > least_importance:
            return
        evaluations = [one for one in missing if one.importance == importance]
        loops = [one for one in undriven if one.importance == importance]
        _record_missing(plan, [one.run for one in evaluations] + [one.run for one in loops], place, say)
        # What an interrupted call has trained is evaluated before more is trained.
        waiting = [one for one in evaluations if not place.has(one.run, one.step)]
        _evaluate(plan, [one for one in evaluations if place.has(one.run, one.step)], place, say, importance)
        untrained = [one.run for one in waiting] + [one.run for one in loops if not place.has(one.run, one.run.steps)]
        if runs := plan.trainings(untrained):
            say(f"importance {importance}: training {_counted(len(runs), 'run')}")
            _train(runs, place)
            _refuse_unsaved(waiting, place)
        _evaluate(plan, waiting, place, say, importance)
        if loops:
            say(f"importance {importance}: recording {_counted(len(loops), 'closed loop')}")
            _each("closed loops", _drive_one, plan, loops, place)


def _refuse_unsaved(evaluations: Sequence[StudyEvaluation], place: Workplace) -> None:
    """Refuse a run that was trained before anybody asked for a checkpoint on its way."""
    for evaluation in evaluations:
        if not place.has(evaluation.run, evaluation.step):
            folder = place.runs / evaluation.run.training_name
            raise ValueError(
                f"{folder} is trained and has no checkpoint of step {evaluation.step}, which the study evaluates: "
                "move the folder away to have it trained again, or give the study another --runs"
            )


def _record_missing(plan: StudyPlan, runs: Sequence[StudyRun], place: Workplace, say: Callable[[str], object]) -> None:
    from dualhead_envs.record import record

    for name in dict.fromkeys(run.dataset for run in runs):
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


def _evaluate(
    plan: StudyPlan, wanted: Sequence[StudyEvaluation], place: Workplace, say: Callable[[str], object], importance: int
) -> None:
    if wanted:
        say(f"importance {importance}: evaluating {_counted(len(wanted), 'checkpoint')}")
        _each("evaluations", _evaluate_one, plan, wanted, place)


def _each[T](
    what: str, do: Callable[[StudyPlan, T, Workplace], None], plan: StudyPlan, wanted: Sequence[T], place: Workplace
) -> None:
    """Do something to each of some items, as many at a time as the workplace has jobs."""
    from joblib import Parallel, delayed, parallel_config

    from dualhead_envs.worker_processes import end_with, interrupts_kept_from_workers

    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        disable=not place.show_progress,
        console=_standard_error(),
    )
    jobs = min(place.jobs, len(wanted))
    with bars:
        task = bars.add_task(what, total=len(wanted))
        if jobs == 1:
            for item in wanted:
                do(plan, item, place)
                bars.advance(task)
            return
        # The workers end with this process, however that ends.
        with parallel_config(backend="loky", initializer=end_with, initargs=(os.getpid(),)):
            parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
            with interrupts_kept_from_workers():
                done = parallel(delayed(do)(plan, item, place) for item in wanted)
            for _ in done:
                bars.advance(task)


def _evaluate_one(plan: StudyPlan, evaluation: StudyEvaluation, place: Workplace) -> None:
    """Evaluate a checkpoint, unless another call on the same results has done so meanwhile."""
    if GateStore(place.gates).has(evaluation):
        return
    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    import torch

    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.draws import HeadPaths, PolicyDraws
    from dualhead_eval.evaluation.samplers import open_policy
    from dualhead_eval.studies.study_evaluation import evaluate_study_run
    from dualhead_policy.training.checkpoints import window_origin

    if place.jobs > 1:
        torch.set_num_threads(1)
    folder = place.checkpoint(evaluation.run, evaluation.step)
    origin = window_origin(folder.parent)
    policy = open_policy(folder, device="cuda" if torch.cuda.is_available() else "cpu")
    draws = evaluation.run.draws
    sampler = policy if draws is None else PolicyDraws(HeadPaths(policy, draws))
    with suppress(FileExistsError):  # the other call was faster, and its gate is the same
        evaluate_study_run(
            evaluation,
            plan.bank(evaluation),
            sampler,
            open_conditions(place.data / evaluation.run.dataset / "test"),
            place.gates,
            training_data="" if origin is None else origin.dataset,
            precision=place.precision,
            device=str(policy.provenance["training"].get("device") or "unknown"),
        )


def _drive_one(plan: StudyPlan, loop: StudyLoop, place: Workplace) -> None:
    """Record a closed loop, if it is not yet, and keep what became of its episodes."""
    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    import torch

    from dualhead_envs.dataset_frames import read_split
    from dualhead_eval.evaluation.closed_loop import record_rollouts
    from dualhead_eval.evaluation.conditions import recorded_environment
    from dualhead_policy.pretrained import load_policy
    from dualhead_policy.training.provenance import policy_provenance

    recording = place.recording(loop)
    if not recording.exists():
        torch.set_num_threads(1)  # a network this small is slower on two
        folder = place.checkpoint(loop.run, loop.run.steps)
        policy, preprocess = load_policy(folder)
        env_id, env_kwargs = recorded_environment(read_split(place.data / loop.run.dataset / "test"))
        record_rollouts(
            policy,
            preprocess,
            recording,
            env_id=env_id,
            env_kwargs=env_kwargs | {"control": loop.control},
            episodes=loop.episodes,
            seed=loop.first_seed,
            provenance=policy_provenance(policy, folder),
        )
    ClosedLoopStore(place.closed_loops).keep(recording, plan, loop)


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _standard_error() -> Any:
    from rich.console import Console

    return Console(stderr=True)
