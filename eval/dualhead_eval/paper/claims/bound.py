"""The claim that no condition lies outside the attainable region: an identity, checked on every table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import both_valid, pair_counts
from dualhead_eval.paper.claims.grade import FAILS, HOLDS, UNGRADED, Grade
from dualhead_eval.statistics.run import Run

CLAIM = "|Delta| <= C and Delta <= C_tight in every condition"
CRITERION = "no table outside (an identity)"


def grade_bound(runs: Sequence[Run]) -> Grade:
    """Tables outside the bounds, over every condition, threshold, number of steps and pair of heads."""
    tables = violations = 0
    for run in runs:
        heads, counts = len(run.gate.heads), run.gate.counts
        for first, second in combinations(range(heads), 2):
            effect = coordination(both_valid(pair_counts(counts, heads, first, second)))
            defined = effect.n > 0
            tables += int(defined.sum())
            outside = (np.abs(effect.delta) > effect.capacity) | (effect.delta > effect.capacity_tight)
            violations += int((outside & defined).sum())
    if not tables:
        return Grade(CLAIM, UNGRADED, "no condition has a both-valid pair", CRITERION)
    return Grade(
        CLAIM, FAILS if violations else HOLDS, f"{violations} of {tables} tables outside the bounds", CRITERION
    )
