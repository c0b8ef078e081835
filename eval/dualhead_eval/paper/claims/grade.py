"""A grade: one claim, what the runs say about it, by which criterion, over which seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dualhead_eval.paper.mechanism import Mechanism
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.training_record import settled

HOLDS, FAILS, OPEN, UNGRADED = "holds", "does not hold", "inconclusive", "not graded"


@dataclass(frozen=True)
class Grade:
    """One claim and what the runs say about it.

    Attributes:
        claim: The claim, as in tab:claims.
        grade: ``holds``, ``does not hold``, ``inconclusive`` or ``not graded``.
        evidence: The numbers behind the grade.
        criterion: What would make it hold.
        seeds: Training seeds behind the evidence.
        loss: How many of the runs had a settled loss.
    """

    claim: str
    grade: str
    evidence: str
    criterion: str
    seeds: str = ""
    loss: str = ""


@dataclass(frozen=True)
class Measured:
    """A run and the mechanism that it measured."""

    run: Run
    mechanism: Mechanism

    @property
    def robot(self) -> bool:
        """Whether the run is one of the paper's robot settings."""
        return self.mechanism.environment in ("v2", "v3") and self.mechanism.standard


def seeds_of(measured: Sequence[Measured]) -> str:
    """How many seeds, and which, for example ``"2 (0, 1)"``; references have none."""
    trained = [m.run.training for m in measured if not m.mechanism.reference]
    known = sorted({record.seed for record in trained if record.seed is not None})
    if not trained:
        return "none: the population"
    if not known:
        return "unknown"
    return f"{len(known)} ({', '.join(map(str, known))})"


def grade_of(
    claim: str, grade: str, evidence: str, criterion: str, measured: Sequence[Measured], *, seeds: str | None = None
) -> Grade:
    """A grade with the seeds and losses of the runs behind it."""
    losses = settled([m.run.training for m in measured])
    return Grade(claim, grade, evidence, criterion, seeds_of(measured) if seeds is None else seeds, losses)
