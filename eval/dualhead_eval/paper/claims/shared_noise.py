"""The claim that shared source noise acts through the representation map: effects of both signs over the maps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED, Grade, Measured, grade_of
from dualhead_eval.statistics.seeds import interaction_test, smallest_p_value

#: Map dependence counts as shown when the signs differ and the spread exceeds this (the paper: 90 points).
MAP_SPREAD = 0.10
#: Level of the permutation test.
LEVEL = 0.05
CLAIM = "The effect of shared source noise depends on the representation map, up to its sign"
CRITERION = f"effects of both signs and a spread above {MAP_SPREAD:.0%} over two or more maps, at p < 5% over seeds"

#: Map -> arm ("A" or "B") -> training seed (or a running number) -> run.
Arms = dict[str, dict[str, dict[Any, Measured]]]


def grade_shared_noise(measured: Sequence[Measured]) -> Grade:
    """Shared noise less independent noise, map by map, between runs of one network and budget.

    References stand in only where no training covers two maps.
    """
    settings = [arms for arms in _settings(measured, reference=False) if _covered(arms) > 1]
    settings = settings or [arms for arms in _settings(measured, reference=True) if _covered(arms) > 1]
    if not settings:
        return Grade(CLAIM, UNGRADED, "shared noise on fewer than two maps in one setting", CRITERION)
    graded = [_grade_setting(arms) for arms in settings]
    grades = {grade.grade for grade in graded}
    if len(graded) == 1:
        return graded[0]
    evidence = "; ".join(f"setting {index + 1}: {grade.evidence}" for index, grade in enumerate(graded))
    seeds = "; ".join(grade.seeds for grade in graded)
    losses = "; ".join(grade.loss for grade in graded)
    return Grade(CLAIM, grades.pop() if len(grades) == 1 else OPEN, evidence, CRITERION, seeds, losses)


def _settings(measured: Iterable[Measured], *, reference: bool) -> list[Arms]:
    settings: dict[tuple[Any, ...], Arms] = {}
    for m in measured:
        mechanism = m.mechanism
        if mechanism.environment != "testbed" or mechanism.n_modes != 2 or mechanism.reference is not reference:
            continue
        letter = mechanism.family[:2]
        if letter in ("A ", "B "):
            arms = settings.setdefault(m.run.training.setting, defaultdict(lambda: {"A": {}, "B": {}}))
            arm = arms[mechanism.representation][letter.strip()]
            arm[len(arm) if m.run.training.seed is None else m.run.training.seed] = m
    return list(settings.values())


def _covered(arms: Arms) -> int:
    return sum(bool(arm["B"]) for arm in arms.values())


def _grade_setting(arms: Arms) -> Grade:
    arms = {name: arm for name, arm in sorted(arms.items()) if arm["B"]}
    runs = [m for arm in arms.values() for letter in ("A", "B") for m in arm[letter].values()]
    # Without an independent run on a map the shared-noise rho itself is the effect.
    effects = {
        name: float(np.mean(_rhos(arm["B"])) - (np.mean(_rhos(arm["A"])) if arm["A"] else 0.0))
        for name, arm in arms.items()
    }
    spread = max(effects.values()) - min(effects.values())
    evidence = ", ".join(f"{name} {value:+.1%}" for name, value in effects.items())
    evidence += f"; spread {100 * spread:.1f} points"
    # A seed counts where it was trained with and without shared noise on every map.
    seeds = sorted(set.intersection(*(set(arm["A"]) & set(arm["B"]) for arm in arms.values())), key=str)
    if all(m.mechanism.reference for m in runs):
        established, evidence = True, evidence + "; the population's own effect"
    elif len(seeds) < 2:
        established, evidence = False, evidence + "; fewer than two seeds on every map and arm, no test"
    else:
        cells = [[arm["B"][s].run.first.rho - arm["A"][s].run.first.rho for s in seeds] for arm in arms.values()]
        test = interaction_test(cells, rng=np.random.default_rng(0))
        evidence += f"; permutation p = {test.p_value:.2g} over {len(seeds)} seeds"
        if test.smallest_p_value >= LEVEL:
            needed = next(n for n in range(len(seeds), 100) if smallest_p_value(len(arms), n) < LEVEL)
            evidence += (
                f", which cannot fall below {test.smallest_p_value:.2g} with {len(arms)} maps and {len(seeds)} seeds: "
                f"{needed} seeds are needed"
            )
        established = test.p_value < LEVEL
    if not min(effects.values()) < 0 < max(effects.values()) or spread <= MAP_SPREAD:
        return grade_of(CLAIM, FAILS, evidence, CRITERION, runs)
    return grade_of(CLAIM, HOLDS if established else OPEN, evidence, CRITERION, runs)


def _rhos(arm: dict[Any, Measured]) -> list[float]:
    return [m.run.first.rho for m in arm.values()]
