"""The curve: separation, floor, ratio and surcharge of every side step, with intervals over seeds and pairs, graded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.studies.monitor.converse.protocol import ConverseBudget, ConverseProtocol
from dualhead_eval.studies.monitor.converse.tally import ReadingName, ReadingTally, RunTally
from dualhead_eval.studies.monitor.families import Families, FamilyMeasure, RunMeasures
from dualhead_eval.studies.monitor.verdicts import MET, NOT_DECIDED, NOT_MET, NOT_TESTED

#: Readings that are graded.
GRADED: tuple[ReadingName, ...] = ("A", "K apart")
#: How a side step came out.
NONE, SURCHARGE, BELOW_ZERO, OPEN = "none", "surcharge", "below zero", "open"


@dataclass(frozen=True)
class Point:
    """One reading at one side step.

    Attributes:
        reading: Its name.
        amplitude_mm: Side step.
        measures: ``separation``, ``floor``, ``ratio``, ``flagged``, ``same``, ``surcharge``, ``other``.
        graded: The surcharge that is graded; None where none is.
        seeds: Number of training seeds.
    """

    reading: ReadingName
    amplitude_mm: int
    measures: dict[str, FamilyMeasure]
    graded: FamilyMeasure | None
    seeds: int

    @property
    def ratio(self) -> float:
        """Separation over floor."""
        return self.measures["ratio"].value

    def finding(self, margin: float) -> str | None:
        """Whether there is no surcharge (TOST), one above the margin or above 0, or neither is decided."""
        if self.graded is None:
            return None
        wide, narrow = self.graded.interval(), self.graded.interval(0.90)
        if -margin < narrow.low and narrow.high < margin:
            return NONE
        if wide.low > 0:
            return SURCHARGE
        return BELOW_ZERO if wide.high < 0 else OPEN


@dataclass(frozen=True)
class ConverseVerdict:
    """C1 or C2 of a reading, the side steps it was asked of, and how it came out."""

    name: str
    reading: ReadingName
    amplitudes_mm: tuple[int, ...]
    grade: str


def curve(tallies: Sequence[RunTally], protocol: ConverseProtocol) -> list[Point]:
    """Every reading at every side step that is scored, in the order of readings and side steps.

    Raises:
        ValueError: If runs hold different numbers of pairs, or nothing is scored.
    """
    numbers = {len(tally.separation_mm) for tally in tallies}
    if len(numbers) != 1:
        raise ValueError(
            f"scored runs hold {sorted(numbers)} pairs of demonstrations, expected one number: repeat the command "
            "without --only-grade"
        )
    families = Families(numbers.pop(), protocol.inference.draws, protocol.inference.seed)
    runs: dict[tuple[ReadingName, int], list[RunMeasures]] = {}
    for tally in sorted(tallies, key=lambda tally: (tally.arm, tally.amplitude_mm, tally.seed)):
        for name, reading in tally.readings.items():
            measured = run_measures(reading, np.array(tally.separation_mm), families.weights)
            runs.setdefault((name, tally.amplitude_mm), []).append(measured)
    found = {key: families.family(members) for key, members in runs.items()}
    return [
        Point(name, amplitude, measures, _graded(name, amplitude, found), len(runs[name, amplitude]))
        for (name, amplitude), measures in sorted(found.items())
    ]


def _graded(
    name: ReadingName, amplitude: int, found: Mapping[tuple[ReadingName, int], dict[str, FamilyMeasure]]
) -> FamilyMeasure | None:
    surcharge = found[name, amplitude]["surcharge"]
    if name == "K apart":
        return surcharge
    if name != "A" or amplitude == 0 or ("A", 0) not in found:
        return None
    reference = found["A", 0]["surcharge"]
    return surcharge - reference if len(reference.by_seed) == len(surcharge.by_seed) else None


def run_measures(reading: ReadingTally, separation: NDArray[np.float64], weights: NDArray[np.float64]) -> RunMeasures:
    """Measures of one run, and their replicates under weights ``(draws, pairs)`` of the pairs of demonstrations."""
    columns = {name: np.array(value, dtype=np.float64) for name, value in reading if name != "threshold_mm"}
    columns["separation"] = separation
    values = {
        name: float(value) for name, value in _measures({k: v.sum() for k, v in columns.items()}, len(separation))
    }
    drawn = dict(_measures({name: weights @ value for name, value in columns.items()}, len(separation)))
    return values, drawn


def _measures(sums: Mapping[str, NDArray[np.float64]], pairs: int) -> list[tuple[str, NDArray[np.float64]]]:
    with np.errstate(divide="ignore", invalid="ignore"):
        flagged = (sums["same_alarms"] + sums["cross_alarms"]) / (sums["same"] + sums["cross"])
        same = sums["same_alarms"] / sums["same"]
        floor = sums["same_mm"] / sums["same"]
        separation = sums["separation"] / pairs
        return [
            ("separation", separation), ("floor", floor), ("ratio", separation / floor), ("flagged", flagged),
            ("same", same), ("surcharge", flagged - same), ("other", sums["other_alarms"] / sums["other"]),
        ]  # fmt: skip


def verdicts(points: Sequence[Point], protocol: ConverseProtocol, budget: ConverseBudget) -> list[ConverseVerdict]:
    """C1 and C2 of every graded reading; not decided before every run of the budget is scored."""
    found = []
    for reading in GRADED:
        asked = [point for point in points if point.reading == reading and point.graded is not None]
        below = [point for point in asked if point.ratio < protocol.criteria.ratio]
        above = [point for point in asked if point.ratio > protocol.criteria.ratio]
        wanted = set(budget.amplitudes_mm["A" if reading == "A" else "K"]) - ({0} if reading == "A" else set())
        complete = {point.amplitude_mm for point in asked if point.seeds == len(budget.seeds)} >= wanted
        for name, points_of, grade in (("C1", below, _no_surcharge), ("C2", above, _surcharge)):
            grades = grade(points_of, protocol.criteria.equivalence)
            if not complete and grades != NOT_TESTED:
                grades = NOT_DECIDED
            found.append(ConverseVerdict(name, reading, tuple(point.amplitude_mm for point in points_of), grades))
    return found


def _no_surcharge(points: Sequence[Point], margin: float) -> str:
    if not points:
        return NOT_TESTED
    if all(point.finding(margin) == NONE for point in points):
        return MET
    beyond = any(point.graded is not None and point.graded.interval().low > margin for point in points)
    return NOT_MET if beyond else NOT_DECIDED


def _surcharge(points: Sequence[Point], margin: float) -> str:
    if not points:
        return NOT_TESTED
    if all(point.graded is not None and point.graded.interval().low > 0 for point in points):
        return MET
    return NOT_MET if any(point.finding(margin) in (NONE, BELOW_ZERO) for point in points) else NOT_DECIDED
