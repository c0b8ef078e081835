"""Checkpoints that several studies evaluate of one training."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from dualhead_eval.studies.study_plan import StudyPlan


def share_checkpoints(plan: StudyPlan, others: Iterable[StudyPlan]) -> StudyPlan:
    """A plan whose trainings also save the checkpoints that other studies evaluate, where they mean the same run.

    A run is trained once: what it has not saved, no study that shares it could evaluate later.
    """
    wanted: dict[str, set[int]] = {}
    own = {run.name: run for run in plan.runs}
    for other in others:
        for run in other.runs:
            mine = own.get(run.training_name)
            if (
                mine is not None
                and other.datasets[run.dataset] == plan.datasets[run.dataset]
                and mine.training == run.training
            ):
                wanted.setdefault(mine.name, set()).update(run.checkpoints)
    runs = tuple(
        replace(run, checkpoints=tuple(sorted({*run.checkpoints, *wanted.get(run.name, ())}))) for run in plan.runs
    )
    return replace(plan, runs=runs)
