"""The sweep's registered criteria, graded as they were written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from dualhead_eval.studies.monitor.regimes.definition import RegimeSweep
from dualhead_eval.studies.monitor.regimes.heads import Arm
from dualhead_eval.studies.monitor.regimes.sweep import Result, Swept
from dualhead_eval.studies.monitor.registration import Gate
from dualhead_eval.studies.monitor.verdicts import MET, NOT_MET, NOT_TESTED


@dataclass(frozen=True)
class Graded:
    """A part of a criterion: its name, what was asked, how it came out, and the numbers."""

    name: str
    asked: str
    grade: str
    found: str


def grade(sweep: RegimeSweep, swept: Swept, gate: Gate) -> list[Graded]:
    """Every criterion; one whose cells are not in the sweep is "not tested".

    Args:
        sweep: The definition.
        swept: What came of it.
        gate: The monitor study's gate, which R3 asks of cells.
    """
    return [
        *_prediction_holds(sweep, swept),
        *_vanishes_below_the_floor(sweep, swept),
        _coordination_removes(sweep, swept, gate),
        *_threshold_climbs(sweep, swept),
        *_paper_null(sweep, swept),
    ]


def passes(result: Result, gate: Gate) -> bool:
    """Whether a cell's heads offer what the monitor study asks of an arm."""
    return (
        result.capacity >= gate.capacity
        and result.cell.token_entropy >= gate.token_entropy_nat
        and result.obedience is not None
        and result.obedience >= gate.obedience
    )


def _word(holds: bool) -> str:
    return MET if holds else NOT_MET


def _select(
    results: Iterable[Result], arms: tuple[Arm, ...], share: float | None = None, separation: float | None = None
) -> list[Result]:
    return [
        one
        for one in results
        if one.arm in arms
        and (share is None or one.flagged_share == share)
        and (separation is None or one.cell.separation == separation)
    ]


def _prediction_holds(sweep: RegimeSweep, swept: Swept) -> list[Graded]:
    least = sweep.criteria.R1.inside_interval
    rows = []
    for share in sweep.flagged_shares:
        results = [one for one in swept.grid if one.flagged_share == share]
        inside = sum(one.predicted.gap in one.found.gap.interval for one in results) / len(results)
        error = sum(abs(one.predicted.gap - one.found.gap.value) for one in results) / len(results)
        found = f"{inside:.1%} of {len(results)}; mean absolute error {100 * error:.2f} points"
        rows.append(Graded("R1", f"f {share:g}: intervals that hold the prediction", _word(inside >= least), found))
    return rows


def _vanishes_below_the_floor(sweep: RegimeSweep, swept: Swept) -> list[Graded]:
    rule = sweep.criteria.R2
    rows = []
    for prior in rule.priors:
        asked = (
            f"prior {prior:g}: the gap at {rule.separation:g} floors less {rule.at_most:g} of that at {rule.against:g}"
        )
        both = [
            [one for one in _select(swept.grid, ("none",), rule.flagged_share, place) if one.cell.prior == prior]
            for place in (rule.separation, rule.against)
        ]
        if not all(both):
            rows.append(Graded("R2", asked, NOT_TESTED, "no such cell"))
            continue
        near, far = both[0][0].found.gap, both[1][0].found.gap
        left = near - rule.at_most * far
        found = f"{_points(left.value)} [{_points(left.interval.low)}, {_points(left.interval.high)}]: "
        found += f"{_points(near.value)} against {_points(far.value)}"
        rows.append(Graded("R2", asked, _word(left.interval.high <= 0), found))
    return rows


def _coordination_removes(sweep: RegimeSweep, swept: Swept, gate: Gate) -> Graded:
    rule = sweep.criteria.R3
    asked = f"cells that pass the gate: at least {rule.removed_at_least:.0%} of the gap taken away"
    apart = _select(swept.grid, ("apart",), rule.flagged_share, rule.separation)
    shared = _select(swept.grid, ("shared",), rule.flagged_share, rule.separation)
    shares, clear = [], True
    for before, after in zip(apart, shared, strict=True):
        if passes(after, gate) and after.removed is not None:
            shares.append(after.removed.value / before.found.gap.value)
            clear &= after.removed.interval.low > 0
    if not shares:
        return Graded("R3", asked, NOT_TESTED, "no such cell")
    holds = clear and min(shares) >= rule.removed_at_least
    return Graded("R3", asked, _word(holds), f"{len(shares)} of {len(shared)} cells; {min(shares):.0%} or more")


def _threshold_climbs(sweep: RegimeSweep, swept: Swept) -> list[Graded]:
    rule = sweep.criteria.R4
    ratios: tuple[list[float], list[float]] = ([], [])
    for one in _select(swept.grid, ("none", "apart", "shared"), separation=rule.separation):
        load = one.flagged_share * one.mismatch / sweep.alpha
        if load <= rule.below:
            ratios[0].append(one.found.threshold / one.found.floor)
        elif load >= rule.above:
            ratios[1].append(one.found.threshold / one.found.floor)
    rows = []
    for asked, values, limit, extreme, holds in (
        (f"f x at most {rule.below:g} alpha: threshold over the floor's at most {rule.threshold_at_most:g}",
         ratios[0], rule.threshold_at_most, max, lambda value, limit: value <= limit),
        (f"f x at least {rule.above:g} alpha: at least {rule.threshold_at_least:g}",
         ratios[1], rule.threshold_at_least, min, lambda value, limit: value >= limit),
    ):  # fmt: skip
        if not values:
            rows.append(Graded("R4", asked, NOT_TESTED, "no such cell"))
            continue
        kept = sum(holds(value, limit) for value in values)
        word = "at most" if extreme is max else "at least"
        found = f"{kept} of {len(values)}; {word} {extreme(values):.2f}"
        rows.append(Graded("R4", asked, _word(kept == len(values)), found))
    return rows


def _paper_null(sweep: RegimeSweep, swept: Swept) -> list[Graded]:
    limit = sweep.paper.resolution
    rows = []
    for names, visible in ((sweep.criteria.R5.invisible, False), (sweep.criteria.R5.visible, True)):
        for name in names:
            apart, shared = swept.paper[name]
            assert shared.removed is not None
            predicted, interval = apart.predicted.gap - shared.predicted.gap, shared.removed.interval
            seen = [abs(value) > limit for value in (predicted, shared.removed.value)]
            asked = f"{name}: {'more' if visible else 'at most'} {_points(limit)} taken away"
            found = f"{_points(shared.removed.value)} [{_points(interval.low)}, {_points(interval.high)}], predicted "
            rows.append(
                Graded("R5", asked, _word(all(seen) if visible else not any(seen)), f"{found}{_points(predicted)}")
            )
    return rows


def _points(value: float) -> str:
    return f"{100 * value:+.2f}"
