"""A study in its smallest form, which shows that it runs."""

from __future__ import annotations

from dualhead_eval.studies.study_file import StudyFile


def smoke_study(study: StudyFile) -> StudyFile:
    """A study in its smallest form: fewer seeds, steps, demonstrations, conditions, pairs and episodes.

    Raises:
        ValueError: If no block is important enough for it.
    """
    smoke = study.smoke
    kept = [block for block in study.runs if block.importance <= smoke.importance and not block.later]
    if not kept:
        raise ValueError(
            f"the study {study.title!r} has no block of importance {smoke.importance} or more for its smoke form: give "
            "its `smoke` another importance"
        )
    largest = max(budget for block in kept for budget in block.budgets)

    def shrunk(steps: int) -> int:
        return max(1, round(steps * smoke.steps / largest))

    blocks = [
        block.model_copy(
            update={
                "seeds": block.seeds[: smoke.seeds],
                "steps": sorted({shrunk(budget) for budget in block.budgets}),
                "evaluate_at": block.evaluate_at and sorted({shrunk(step) for step in block.evaluate_at}),
                "closed_loops": block.closed_loops
                and block.closed_loops.model_copy(update={"episodes": smoke.closed_loop_episodes}),
            }
        )
        for block in kept
    ]
    datasets = {
        name: dataset.model_copy(
            update={"pairs": smoke.demonstration_pairs}
            if dataset.pairs is not None
            else {"episodes": smoke.episodes, "conditions": smoke.conditions}
        )
        for name, dataset in study.datasets.items()
    }
    banks = {
        name: bank.model_copy(update={"conditions": None, "pairs": smoke.pairs}) for name, bank in study.banks.items()
    }
    return study.model_copy(update={"runs": blocks, "datasets": datasets, "banks": banks})
