"""Differences between two mechanisms, with intervals over seeds where there are seeds, over conditions otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from dualhead_eval.gate import Gate
from dualhead_eval.statistics.bootstrap import BOOTSTRAP_DRAWS, BOOTSTRAP_SEED, Resamples, resample_weights
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.run_statistics import condition_sums


@dataclass(frozen=True)
class Difference:
    """A statistic of one mechanism minus another's.

    Attributes:
        value: The difference of the means.
        interval: Its 95% interval, NaN where it is undefined.
        unit: What was resampled: ``"seeds"`` (a statement about mechanisms) or ``"conditions"`` (about checkpoints).
    """

    value: float
    interval: Interval
    unit: str


def difference(runs: Sequence[Run], baseline: Sequence[Run], name: str) -> Difference:
    """Mean of ``name`` over ``runs`` minus its mean over ``baseline``.

    With two seeds or more on both sides Welch's t interval over seeds; otherwise a bootstrap over conditions, in which
    both sides keep the same conditions if they were evaluated under the same.

    Args:
        runs: Seeds of one mechanism.
        baseline: Seeds of another, trained and evaluated alike.
        name: A statistic of :class:`dualhead_eval.statistics.run_summary.RunSummary`.
    """
    ours, theirs = (np.array([getattr(run.first, name) for run in side]) for side in (runs, baseline))
    value = float(ours.mean() - theirs.mean())
    if min(len(ours), len(theirs)) > 1:
        return Difference(value, welch_interval(ours, theirs), "seeds")
    return Difference(value, _over_conditions(runs, baseline, name), "conditions")


def welch_interval(first: np.ndarray, second: np.ndarray, level: float = 0.95) -> Interval:
    """Welch's interval for the difference of two means; of no width where neither side varies."""
    squared = [side.var(ddof=1) / side.size for side in (first, second)]
    value, error = float(first.mean() - second.mean()), float(np.sqrt(sum(squared)))
    if error == 0:
        return Interval(value, value, level)
    if np.isnan(error):
        return Interval(float("nan"), float("nan"), level)
    freedom = sum(squared) ** 2 / sum(s**2 / (side.size - 1) for s, side in zip(squared, (first, second), strict=True))
    half = float(t.ppf((1 + level) / 2, freedom) * error)
    return Interval(value - half, value + half, level)


def _over_conditions(runs: Sequence[Run], baseline: Sequence[Run], name: str) -> Interval:
    gates = [run.gate for run in (*runs, *baseline)]
    same = all(_conditions(gate) == _conditions(gates[0]) for gate in gates)
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    weights = resample_weights(gates[0].n_conditions, BOOTSTRAP_DRAWS, rng)
    sides = []
    for side in (runs, baseline):
        replicates = []
        for run in side:
            sums = condition_sums(run.gate.pair_table(tau=run.first.tau, nfe=run.first.nfe), run.first.estimator)
            own = weights if same else resample_weights(len(sums.terms), BOOTSTRAP_DRAWS, rng)
            replicates.append(sums.statistics(own @ sums.terms)[name])
        sides.append(np.mean(replicates, axis=0))
    return Resamples({name: sides[0] - sides[1]}).interval(name, 0.95)


def _conditions(gate: Gate) -> tuple[list[int], list[list[float]]]:
    return gate.pair_ids.tolist(), gate.conditions.tolist()
