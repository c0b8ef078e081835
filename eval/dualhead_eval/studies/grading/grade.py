"""A graded criterion: what each of its cells shows, and what they show together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.studies.study_cells import StudyCell

__all__ = ["FAILS", "HOLDS", "OPEN", "UNGRADED", "CellGrade", "StudyGrade", "points", "together", "with_interval"]


@dataclass(frozen=True)
class CellGrade:
    """One cell, or comparison of cells, under a criterion.

    Attributes:
        name: What it is about.
        grade: ``holds``, ``does not hold``, ``inconclusive`` or ``not graded``.
        evidence: The numbers behind it.
    """

    name: str
    grade: str
    evidence: str


@dataclass(frozen=True)
class StudyGrade:
    """A criterion and what the study says about it.

    Attributes:
        name, claim, criterion: As in the study's file.
        grade: Of all cells together: it holds if all do, it does not if one does not.
        cells: What each shows.
        shortage: Cells and seeds that the criterion asks for and the study has not got.
    """

    name: str
    claim: str
    criterion: str
    grade: str
    cells: tuple[CellGrade, ...]
    shortage: tuple[str, ...] = ()

    @property
    def evidence(self) -> str:
        """Which cells decide: those that do not hold, or how many hold."""
        against = [cell for cell in self.cells if cell.grade != HOLDS]
        shown = against or self.cells
        text = "; ".join(f"{cell.name}: {cell.evidence}" for cell in shown)
        held = len(self.cells) - len(against)
        return f"{held} of {len(self.cells)} hold. {text}" if len(self.cells) > 1 else text


def together(cells: Sequence[CellGrade]) -> str:
    """One grade of several cells."""
    grades = [cell.grade for cell in cells if cell.grade != UNGRADED]
    if not grades:
        return UNGRADED
    for grade in (FAILS, OPEN):
        if grade in grades:
            return grade
    return HOLDS


def points(value: float, interval: Interval | None = None) -> str:
    """A share in percentage points, with its interval."""
    text = f"{100 * value:+.1f}"
    if interval is None:
        return text
    return f"{text} [{100 * interval.low:+.1f}, {100 * interval.high:+.1f}]"


def with_interval(value: float, interval: Interval | None, form: str) -> str:
    """A number, and its interval where there is one, in one form."""
    text = format(value, form)
    return text if interval is None else f"{text} [{interval.low:{form}}, {interval.high:{form}}]"


def seeds_behind(cell: StudyCell) -> str:
    """How many seeds are behind a number."""
    return f"n = {len(cell.read)}"
