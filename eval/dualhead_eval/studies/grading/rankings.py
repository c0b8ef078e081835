"""Whether the order of some rows depends on the threshold and on the number of Euler steps (app:sensitivity)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from dualhead_eval.studies.criterion import RankingCriterion
from dualhead_eval.studies.grading.grade import FAILS, HOLDS, UNGRADED, CellGrade, points
from dualhead_eval.studies.operating_points import OperatingPoint, operating_points
from dualhead_eval.studies.study_cells import StudyCell


def grade_ranking(cells: Sequence[StudyCell], criterion: RankingCriterion) -> CellGrade:
    """No two rows change places by more than ``tie`` in their mean effect, wherever both have one."""
    low, high = criterion.between
    scans = {
        cell.configuration: {(p.tau, p.nfe): p for p in operating_points(cell) if low <= p.tau <= high}
        for cell in cells
    }
    name = cells[0].dataset
    shared = set.intersection(*(set(scan) for scan in scans.values())) if len(scans) > 1 else set()
    if len(shared) < 2:
        return CellGrade(name, UNGRADED, "fewer than two rows at two operating points")
    swapped = [
        f"{one} and {other} {points(min(gaps))} to {points(max(gaps))} points of effect"
        for one, other in combinations(scans, 2)
        if (gaps := _gaps(scans[one], scans[other], shared)) and min(gaps) < -criterion.tie < criterion.tie < max(gaps)
    ]
    taus, steps = (sorted({key[axis] for key in shared}) for axis in (0, 1))
    where = f"{len(shared)} points, tau {taus[0]:g} to {taus[-1]:g}, {steps[0]} to {steps[-1]} steps"
    valid = min(scan[key].mean("valid_rate") for scan in scans.values() for key in shared)
    if swapped:
        return CellGrade(name, FAILS, f"{'; '.join(swapped)} ({where}, valid down to {valid:.3f})")
    order = sorted(scans, key=lambda row: -_mean_effect(scans[row], shared))
    return CellGrade(name, HOLDS, f"{' > '.join(order)} ({where}, valid down to {valid:.3f})")


def _mean_effect(scan: dict[tuple[float, int], OperatingPoint], shared: set[tuple[float, int]]) -> float:
    """Mean effect of a row over operating points."""
    return sum(scan[key].mean("delta") for key in shared) / len(shared)


def _gaps(
    one: dict[tuple[float, int], OperatingPoint],
    other: dict[tuple[float, int], OperatingPoint],
    shared: set[tuple[float, int]],
) -> list[float]:
    gaps = [one[key].mean("delta") - other[key].mean("delta") for key in shared]
    return [gap for gap in gaps if gap == gap]
