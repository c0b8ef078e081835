"""Measures of an arm over its training seeds, with replicates that draw seeds and episodes together for all arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.monitor.detection.comparison import percentile_interval, replicates
from dualhead_eval.statistics.bootstrap import resample_weights
from dualhead_eval.statistics.interval import Interval


@dataclass(frozen=True)
class FamilyMeasure:
    """A measure of an arm, or a difference between two.

    Attributes:
        value: Mean over training seeds.
        by_seed: The measure of every seed ``(S,)``.
        replicates: Bootstrap replicates of the mean ``(draws,)``.
    """

    value: float
    by_seed: NDArray[np.float64]
    replicates: NDArray[np.float64]

    def interval(self, level: float = 0.95) -> Interval:
        """Percentile interval."""
        return percentile_interval(self.replicates, level)

    def __sub__(self, other: FamilyMeasure) -> FamilyMeasure:
        """The difference, seed by seed and replicate by replicate."""
        return FamilyMeasure(self.value - other.value, self.by_seed - other.by_seed, self.replicates - other.replicates)

    def beyond(self, bound: float, *, above: bool) -> float:
        """One-sided p value against the measure lying at ``bound`` or on its other side.

        Args:
            bound: The bound.
            above: Whether the measure should lie above it.
        """
        wrong = self.replicates <= bound if above else self.replicates >= bound
        return float((1 + (wrong | np.isnan(self.replicates)).sum()) / (1 + self.replicates.size))


#: Values and replicates of every measure of one run and signal.
RunMeasures = tuple[Mapping[str, float], Mapping[str, NDArray[np.float64]]]


class Families:
    """Replicates of runs and families from one draw of episodes.

    Args:
        episodes: Number of test episodes.
        draws: Bootstrap replicates.
        seed: Seed of the bootstrap.
    """

    def __init__(self, episodes: int, draws: int, seed: int) -> None:
        self.draws, self.seed = draws, seed
        self.weights = resample_weights(episodes, draws, np.random.default_rng(seed))

    def run(self, step: AlarmLog, episode: AlarmLog, signal: str) -> RunMeasures:
        """Measures of one signal of one run, given its alarms per decision and per episode."""
        values, drawn = replicates(episode, signal, self.weights, ("auroc", "detection"))
        by_step, drawn_by_step = replicates(step, signal, self.weights, ("false_alarms",))
        shares = self.alarm_shares(episode, signal)
        return {**values, **by_step, **shares[0]}, {**drawn, **drawn_by_step, **shares[1]}

    def alarm_shares(self, log: AlarmLog, signal: str) -> RunMeasures:
        """Shares of episodes with an alarm at any time: ``false_episodes`` of successes, ``detected`` of failures."""
        alarms = np.array([marks.any() for marks in log.exceeded(signal)], dtype=np.float64)
        values, drawn = {}, {}
        for name, counted in (("false_episodes", log.success), ("detected", ~log.success)):
            total, having = self.weights @ counted, self.weights @ (counted * alarms)
            values[name] = float((counted * alarms).sum() / counted.sum()) if counted.any() else float("nan")
            drawn[name] = np.divide(having, total, out=np.full(self.draws, np.nan), where=total > 0)
        return values, drawn

    def family(self, runs: Sequence[RunMeasures]) -> dict[str, FamilyMeasure]:
        """Measures of an arm over its training seeds; arms of as many seeds draw the same of them."""
        rng = np.random.default_rng([self.seed, len(runs)])
        counts = rng.multinomial(len(runs), np.full(len(runs), 1 / len(runs)), size=self.draws)
        found = {}
        for name in runs[0][0]:
            each = np.stack([drawn[name] for _, drawn in runs], axis=1)
            mean = np.where(counts > 0, counts * each, 0.0).sum(axis=1) / len(runs)
            by_seed = np.array([values[name] for values, _ in runs])
            found[name] = FamilyMeasure(float(by_seed.mean()), by_seed, mean)
        return found


def holm(p_values: Mapping[str, float], alpha: float, planned: int) -> dict[str, bool]:
    """Holm's rule: which of the hypotheses are rejected at a family-wise ``alpha``.

    Args:
        p_values: p value by name.
        alpha: The family's rate.
        planned: Hypotheses of the family; those without a p value yet count as not rejected.
    """
    rejected, still = {}, True
    for rank, (name, p) in enumerate(sorted(p_values.items(), key=lambda item: item[1])):
        still = still and p <= alpha / (planned - rank)
        rejected[name] = still
    return rejected
