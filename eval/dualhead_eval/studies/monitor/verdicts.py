"""The registered criteria, graded as they were written: met, not met, not decided, not tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dualhead_eval.statistics.interval import Interval
from dualhead_eval.studies.monitor.families import FamilyMeasure
from dualhead_eval.studies.monitor.registration import Criteria, DistributionRival

MET, NOT_MET, NOT_DECIDED, NOT_TESTED = "met", "not met", "not decided", "not tested"


@dataclass(frozen=True)
class Verdict:
    """A criterion and how it came out.

    Attributes:
        name: P1, P2, S1, S2, S4, S5a, S5b, S6a or S6b.
        measure: What was compared, in words.
        value: The difference.
        interval: The interval that decides.
        grade: One of the four words, or "reported" for what is not tested.
        reason: Why, in words.
        p_value: One-sided p value of P1 and P2.
    """

    name: str
    measure: str
    value: float
    interval: Interval
    grade: str
    reason: str
    p_value: float | None = None


def grade_false_alarms(arm: FamilyMeasure, baseline: FamilyMeasure, criteria: Criteria) -> Verdict:
    """P1 on the gap of an arm and of the baseline."""
    rule = criteria.P1
    difference = arm - baseline
    interval = difference.interval()
    share = arm.value / baseline.value if baseline.value > 0 else float("nan")
    reason = f"gap {arm.value:+.1%} against {baseline.value:+.1%}"
    if interval.high < rule.upper_below and arm.value <= rule.at_most_share_of_baseline * baseline.value:
        grade = MET
    elif interval.high < rule.upper_below:
        grade, reason = NOT_MET, f"{reason}: {share:.0%} of it is left"
    elif interval.low > rule.upper_below:
        grade = NOT_MET
    else:
        grade = NOT_DECIDED
    p = difference.beyond(rule.upper_below, above=False)
    return Verdict("P1", f"{rule.signal}, gap of false alarms", difference.value, interval, grade, reason, p)


def grade_detection(arm: FamilyMeasure, baseline: FamilyMeasure, criteria: Criteria) -> Verdict:
    """P2 on the AUROC of an arm and of the baseline: not worse by more than the margin."""
    rule = criteria.P2
    difference = arm - baseline
    interval = difference.interval()
    grade = _one_sided(met=interval.low > rule.lower_above, excluded=interval.high < rule.lower_above)
    reason = f"AUROC {arm.value:.3f} against {baseline.value:.3f}, margin {rule.lower_above:g}"
    if arm.value != arm.value or baseline.value != baseline.value:
        reason = "no kind and level has enough successes and failures to be compared"
    p = difference.beyond(rule.lower_above, above=True)
    return Verdict("P2", f"{rule.signal}, AUROC", difference.value, interval, grade, reason, p)


def grade_rival(arm: FamilyMeasure, rival: FamilyMeasure, criteria: Criteria) -> Verdict:
    """S2: is the baseline's matched residual as good as the arm's residual, or better?"""
    rule = criteria.S2
    difference = rival - arm
    interval, wide = difference.interval(0.90), difference.interval()
    inside = -rule.equivalence < interval.low and interval.high < rule.equivalence
    words = [
        word for word, holds in (("equivalent", inside), ("better", wide.low > 0), ("worse", wide.high < 0)) if holds
    ]
    grade = ", ".join(words) or NOT_DECIDED
    reason = (
        f"AUROC {rival.value:.3f} without coordination against {arm.value:.3f} with it; 95 % [{wide.low:+.3f}, "
        f"{wide.high:+.3f}]"
    )
    measure = f"{rule.signal} of the baseline against {rule.against} of the arm, AUROC"
    return Verdict("S2", measure, difference.value, interval, grade, reason)


def grade_distribution_rival(
    arm: Mapping[str, FamilyMeasure], rival: Mapping[str, FamilyMeasure], rule: DistributionRival
) -> list[Verdict]:
    """S5: does the baseline's signal detect no worse than the arm's (a), with a smaller gap (b)?"""
    detection = rival[rule.detection.measure] - arm[rule.detection.measure]
    gap = rival[rule.false_alarms.measure] - arm[rule.false_alarms.measure]
    bounds = detection.interval(), gap.interval()
    low, high = rule.detection.lower_above, rule.false_alarms.upper_below
    between = f"{rule.signal} of the baseline against {rule.against} of the arm"
    return [
        Verdict(
            "S5a", f"{between}, AUROC", detection.value, bounds[0],
            _one_sided(met=bounds[0].low > low, excluded=bounds[0].high < low),
            f"{rival[rule.detection.measure].value:.3f} without coordination against "
            f"{arm[rule.detection.measure].value:.3f} with it, margin {low:g}",
        ),
        Verdict(
            "S5b", f"{between}, gap of false alarms", gap.value, bounds[1],
            _one_sided(met=bounds[1].high < high, excluded=bounds[1].low > high),
            f"{rival[rule.false_alarms.measure].value:+.1%} without coordination against "
            f"{arm[rule.false_alarms.measure].value:+.1%} with it",
        ),
    ]  # fmt: skip


def _one_sided(*, met: bool, excluded: bool) -> str:
    """The grade of a bound: the whole interval keeps it, breaks it, or holds it."""
    return MET if met else NOT_MET if excluded else NOT_DECIDED


def report_difference(name: str, measure: str, arm: FamilyMeasure, baseline: FamilyMeasure) -> Verdict:
    """S1 and S4: the difference with its interval."""
    difference = arm - baseline
    reason = f"{arm.value:.1%} against {baseline.value:.1%}"
    return Verdict(name, measure, difference.value, difference.interval(), "reported", reason)


def report_beside_primary(
    primary: str, arm: Mapping[str, FamilyMeasure], other: Mapping[str, FamilyMeasure]
) -> list[Verdict]:
    """S6: a resampled arm less the primary arm, whose coordination was trained: the gap (a) and the AUROC (b)."""

    def reported(name: str, measure: str, words: str, spec: str) -> Verdict:
        difference = arm[measure] - other[measure]
        reason = f"{arm[measure].value:{spec}} against {other[measure].value:{spec}}"
        what = f"{words}, less that of {primary}"
        return Verdict(name, what, difference.value, difference.interval(), "reported", reason)

    return [reported("S6a", "gap", "gap of false alarms", "+.1%"), reported("S6b", "auroc", "AUROC", ".3f")]
