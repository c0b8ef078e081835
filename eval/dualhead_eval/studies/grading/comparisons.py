"""Criteria that compare cells: with a baseline, along a ladder, over maps, over banks, over steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import spearmanr

from dualhead_eval.paper.claims.consistency import NEGLIGIBLE_COST
from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED
from dualhead_eval.paper.claims.shared_noise import LEVEL
from dualhead_eval.statistics.difference import difference, welch_interval
from dualhead_eval.statistics.seeds import interaction_test, seed_t_interval
from dualhead_eval.studies.criterion import BanksCriterion, DifferenceCriterion, TrendCriterion
from dualhead_eval.studies.grading.grade import CellGrade, points, seeds_behind
from dualhead_eval.studies.study_cells import StudyCell, common_seeds

#: Random relabellings of an interaction test (sec:toy-mapping).
PERMUTATIONS = 10_000


def grade_difference(cell: StudyCell, baseline: StudyCell, criterion: DifferenceCriterion) -> CellGrade:
    """A row less its baseline, Welch over seeds."""
    name = f"{cell.name} - {baseline.name.partition('/')[2]}"
    if min(len(cell.read), len(baseline.read)) < 2:
        return CellGrade(name, UNGRADED, "fewer than two seeds a side that can be read")
    effect = difference(cell.read, baseline.read, criterion.statistic)
    evidence = f"{criterion.statistic} {points(effect.value, effect.interval)} points"
    if criterion.within is not None:
        inside = -criterion.within <= effect.interval.low and effect.interval.high <= criterion.within
        outside = effect.interval.low > criterion.within or effect.interval.high < -criterion.within
        return CellGrade(name, HOLDS if inside else FAILS if outside else OPEN, evidence)
    if not criterion.cost:
        up, down = effect.interval.low > 0, effect.interval.high < 0
        return CellGrade(name, HOLDS if up else FAILS if down else OPEN, evidence)
    cost = difference(cell.read, baseline.read, "valid_rate")
    evidence += f", valid pairs {points(cost.value, cost.interval)} points"
    if effect.interval.high < 0 or cost.interval.low > -NEGLIGIBLE_COST:
        return CellGrade(name, FAILS, evidence)
    return CellGrade(name, HOLDS if effect.interval.low > 0 and cost.interval.high < 0 else OPEN, evidence)


def grade_accounts(cells: Sequence[StudyCell], whole: StudyCell, baseline: StudyCell, share: float) -> CellGrade:
    """Whether one row alone makes up a share of the whole difference."""
    gap = whole.mean("rho") - baseline.mean("rho")
    lines, found = [f"whole {points(gap)} points"], []
    for cell in cells:
        if min(len(cell.read), len(baseline.read)) < 2:
            lines.append(f"{cell.configuration} not enough seeds")
            continue
        effect = difference(cell.read, baseline.read, "rho")
        lines.append(f"{cell.configuration} {points(effect.value, effect.interval)}")
        found.append(effect.interval.low > 0 and effect.value >= share * gap)
    if not found or gap != gap:
        return CellGrade(whole.dataset, UNGRADED, "; ".join(lines))
    grade = HOLDS if any(found) else FAILS if len(found) == len(cells) else OPEN
    return CellGrade(whole.dataset, grade, "; ".join(lines))


def grade_monotone(ladder: Sequence[StudyCell]) -> CellGrade:
    """Means over seeds that increase from rung to rung."""
    means = [cell.mean("rho") for cell in ladder]
    name = ladder[0].dataset
    evidence = ", ".join(f"{cell.configuration} {points(mean)}" for cell, mean in zip(ladder, means, strict=True))
    if any(mean != mean for mean in means):
        return CellGrade(name, UNGRADED, evidence)
    return CellGrade(name, HOLDS if bool((np.diff(means) > 0).all()) else FAILS, evidence)


def grade_interaction(arms: Sequence[tuple[StudyCell, StudyCell]], bank: str) -> CellGrade:
    """Does row less baseline depend on the dataset? Blocked permutation within seeds.

    Args:
        arms: (row, baseline) of every dataset.
        bank: The bank's name.
    """
    seeds = common_seeds([cell for pair in arms for cell in pair])
    if len(seeds) < 2 or len(arms) < 2:
        return CellGrade(f"bank {bank}", UNGRADED, "fewer than two seeds on every map and arm")
    differences = np.array([effects_by_seed(row, baseline, seeds) for row, baseline in arms])
    test = interaction_test(differences, permutations=PERMUTATIONS, rng=np.random.default_rng(0))
    lines = [
        f"{row.dataset} {points(own.mean(), seed_t_interval(own))}"
        for (row, _), own in zip(arms, differences, strict=True)
    ]
    conditions = arms[0][0].runs[0].gate.n_conditions
    evidence = f"D: {', '.join(lines)}; range {points(test.spread)} points, p = {test.p_value:.2g}, {len(seeds)} seeds"
    both = min(test.effects) < 0 < max(test.effects)
    grade = (HOLDS if both else FAILS) if test.p_value < LEVEL else OPEN
    return CellGrade(f"{conditions} conditions", grade, evidence)


def grade_banks(arms: Sequence[tuple[StudyCell, StudyCell]], criterion: BanksCriterion) -> CellGrade:
    """The sign of row less baseline on every bank, and whether the banks agree."""
    name = arms[0][0].dataset
    lines, means, signs = [], [], []
    for row, baseline in arms:
        seeds = common_seeds([row, baseline])
        if len(seeds) < 2:
            return CellGrade(name, UNGRADED, f"fewer than two seeds on bank {row.bank}")
        own = effects_by_seed(row, baseline, seeds)
        interval = seed_t_interval(own)
        means.append(own.mean())
        signs.append(interval.high < 0 if criterion.expect == "negative" else interval.low > 0)
        lines.append(f"{row.runs[0].gate.n_conditions} conditions {points(own.mean(), interval)}")
    agree = max(means) - min(means) <= criterion.margin
    return CellGrade(name, HOLDS if all(signs) and agree else FAILS, ", ".join(lines))


def grade_trend(start: StudyCell, end: StudyCell, criterion: TrendCriterion) -> CellGrade:
    """rho at the end less rho at the start, paired by seed: stays or rises, falls, or undecided."""
    seeds = common_seeds([start, end])
    if len(seeds) < 2:
        return CellGrade(end.name, UNGRADED, "fewer than two seeds at both ends")
    first, last = (np.array([cell.by_seed("rho")[seed] for seed in seeds]) for cell in (start, end))
    interval = seed_t_interval(last - first)
    evidence = (
        f"rho {points(first.mean())} at {start.step:,}, {points(last.mean())} at {end.step:,} steps: "
        f"{points((last - first).mean(), interval)} points; valid pairs {start.mean('valid_rate'):.3f} to "
        f"{end.mean('valid_rate'):.3f}, {len(seeds)} seeds"
    )
    if interval.low > -criterion.margin:
        return CellGrade(end.name, HOLDS, evidence)
    return CellGrade(end.name, FAILS if interval.high < -criterion.margin else OPEN, evidence)


def grade_order(cells: Sequence[StudyCell], at_most: float) -> CellGrade:
    """Rank correlation of mean rho with mean valid-pair rate."""
    drawn = [cell for cell in cells if cell.mean("rho") == cell.mean("rho")]
    name = cells[0].dataset
    if len(drawn) < 3:
        return CellGrade(name, UNGRADED, "fewer than three cells")
    rho, valid = ([cell.mean(key) for cell in drawn] for key in ("rho", "valid_rate"))
    correlation = float(spearmanr(rho, valid).statistic)
    if correlation != correlation:
        return CellGrade(name, UNGRADED, "all cells alike")
    return CellGrade(name, HOLDS if correlation <= at_most else FAILS, f"{correlation:+.2f} over {len(drawn)} cells")


def grade_repairs(cell: StudyCell, baseline: StudyCell) -> CellGrade:
    """Less distortion of the modes' frequencies and more coordination than the baseline."""
    if min(len(cell.read), len(baseline.read)) < 2:
        return CellGrade(cell.name, UNGRADED, "fewer than two seeds a side that can be read")
    ours, theirs = (distortion(side) for side in (cell, baseline))
    distorted = welch_interval(ours, theirs)
    effect = difference(cell.read, baseline.read, "rho")
    evidence = (
        f"TV {ours.mean():.3f} against {theirs.mean():.3f} ({points(ours.mean() - theirs.mean(), distorted)}), "
        f"rho {points(effect.value, effect.interval)} points, {seeds_behind(cell)}"
    )
    if distorted.low > 0 or effect.interval.high < 0:
        return CellGrade(cell.name, FAILS, evidence)
    return CellGrade(cell.name, HOLDS if distorted.high < 0 and effect.interval.low > 0 else OPEN, evidence)


def distortion(cell: StudyCell) -> np.ndarray:
    """TV between generated and target mode frequencies, mean of both heads, by seed."""
    return (cell.values("tv_target_q") + cell.values("tv_target_p")) / 2


def effects_by_seed(row: StudyCell, baseline: StudyCell, seeds: Sequence[int]) -> np.ndarray:
    """rho of a row less that of its baseline, seed by seed."""
    ours, theirs = row.by_seed("rho"), baseline.by_seed("rho")
    return np.array([ours[seed] - theirs[seed] for seed in seeds])
