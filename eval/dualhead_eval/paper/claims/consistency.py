"""The claim that endpoint consistency coordinates at a cost in validity: against shared noise without it.

The paper's baseline is B (sec:interior: the valid-pair rate falls from B's 0.768 to G's 0.525). Both sides must have
one environment, network, budget and batch size: a difference of networks is not the loss's effect.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED, Grade, Measured, grade_of, seeds_of
from dualhead_eval.statistics.difference import Difference, difference

#: A loss of valid pairs that is smaller than this, with its whole interval, is no cost.
NEGLIGIBLE_COST = 0.01
CLAIM = "Endpoint consistency coordinates without a partition, at a cost in valid pairs"
CRITERION = (
    "against shared noise of the same network and steps: 95% interval of rho's difference above zero, that of the "
    f"valid-pair rate's below zero (within {NEGLIGIBLE_COST:.0%} of zero: no cost)"
)

Settings = dict[tuple[Any, ...], tuple[list[Measured], list[Measured]]]


def grade_consistency(measured: Sequence[Measured]) -> Grade:
    """Runs with weight 3 or more and shared noise, less shared noise alone, setting by setting."""
    settings: Settings = defaultdict(lambda: ([], []))
    for m in measured:
        mechanism = m.mechanism
        plain = mechanism.beta == 0 and mechanism.token is None and mechanism.latent is None
        if m.robot and plain and (mechanism.consistency == 0 or mechanism.consistency >= 3):
            settings[(mechanism.environment, *m.run.training.setting)][mechanism.consistency == 0].append(m)
    matched = {key: sides for key, sides in settings.items() if all(sides)}
    alone = [m for key, (climb, _) in settings.items() if key not in matched for m in climb]
    if not matched and not alone:
        return Grade(CLAIM, UNGRADED, "no robot run with consistency weight 3 and shared noise", CRITERION)
    unmatched = ", ".join(m.run.name for m in alone)
    if unmatched:
        unmatched = f"no shared-noise run of the same network and steps beside {unmatched}"
    if not matched:
        return grade_of(CLAIM, UNGRADED, unmatched, CRITERION, alone)
    graded = [_grade_setting(climb, base) for climb, base in matched.values()]
    grades = {grade for grade, _ in graded}
    evidence = "; ".join([text for _, text in graded] + ([unmatched] if unmatched else []))
    used = [m for sides in matched.values() for side in sides for m in side]
    climbs, bases = ([m for sides in matched.values() for m in sides[side]] for side in (0, 1))
    seeds = f"G {seeds_of(climbs)}, B {seeds_of(bases)}"
    return grade_of(CLAIM, grades.pop() if len(grades) == 1 else OPEN, evidence, CRITERION, used, seeds=seeds)


def _grade_setting(climb: Sequence[Measured], base: Sequence[Measured]) -> tuple[str, str]:
    runs, baseline = [m.run for m in climb], [m.run for m in base]
    effect, cost = (difference(runs, baseline, name) for name in ("rho", "valid_rate"))
    training = climb[0].run.training
    where = f"{climb[0].mechanism.environment}, {training.steps} steps, {training.network_name or 'unknown network'}"
    unit = f"over {effect.unit}" if effect.unit == "seeds" else "over conditions, one checkpoint a side"
    evidence = f"{where}: rho {_points(effect)}, valid pairs {_points(cost)} ({unit})"
    if effect.interval.high < 0 or cost.interval.low > -NEGLIGIBLE_COST:
        return FAILS, evidence
    return (HOLDS if effect.interval.low > 0 and cost.interval.high < 0 else OPEN), evidence


def _points(d: Difference) -> str:
    if d.interval.low != d.interval.low:
        return f"{100 * d.value:+.1f} points [undefined]"
    return f"{100 * d.value:+.1f} points [{100 * d.interval.low:+.1f},{100 * d.interval.high:+.1f}]"
