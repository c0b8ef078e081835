"""Two arms on one log of episodes: the difference of every measure, with episodes resampled together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.monitor.detection.concordance import compare_scores, compare_traces
from dualhead_eval.monitor.detection.detection import detection_at, largest_aggregates
from dualhead_eval.monitor.detection.false_alarms import false_alarms
from dualhead_eval.statistics.bootstrap import BOOTSTRAP_DRAWS, BOOTSTRAP_SEED, resample_weights
from dualhead_eval.statistics.interval import Interval

#: Rates of false alarms per episode at which detection is reported.
DETECTION_RATES = (0.05, 0.10)
#: Groups of measures.
GROUPS = ("auroc", "false_alarms", "detection")


@dataclass(frozen=True)
class Measure:
    """A number with its 95% percentile interval over episodes."""

    value: float
    interval: Interval


def measures(
    log: AlarmLog, signal: str, *, draws: int = BOOTSTRAP_DRAWS, seed: int = BOOTSTRAP_SEED
) -> dict[str, Measure]:
    """Every measure of one signal, with intervals; false alarms only where the decisions are flagged."""
    values, drawn = replicates(log, signal, episode_weights(log, draws, seed))
    return {name: Measure(values[name], percentile_interval(drawn[name])) for name in values}


def differences(
    first: AlarmLog,
    second: AlarmLog,
    signal: str,
    *,
    second_signal: str | None = None,
    draws: int = BOOTSTRAP_DRAWS,
    seed: int = BOOTSTRAP_SEED,
) -> dict[str, Measure]:
    """Every measure of ``first`` minus that of ``second`` on the same episodes, resampled together.

    Args:
        first: One arm.
        second: The other.
        signal: The signal.
        second_signal: The other arm's signal, the same by default.
        draws: Bootstrap replicates.
        seed: Seed of the bootstrap.

    Raises:
        ValueError: If the two logs hold different episodes, or the same in another order, or other aggregates or
            thresholds.
    """
    require_one_monitor([first, second])
    keys = [[episode.key for episode in log.document.episodes] for log in (first, second)]
    if keys[0] != keys[1]:
        raise ValueError(
            f"{first.label} and {second.label} score different episodes, expected one log of rollouts: score both with "
            "--policy on the same recording"
        )
    weights = episode_weights(first, draws, seed)
    ours, ours_drawn = replicates(first, signal, weights)
    theirs, theirs_drawn = replicates(second, second_signal or signal, weights)
    return {
        name: Measure(ours[name] - theirs[name], percentile_interval(ours_drawn[name] - theirs_drawn[name]))
        for name in ours.keys() & theirs.keys()
    }


def require_one_monitor(logs: Sequence[AlarmLog]) -> None:
    """Refuse to compare alarms of monitors that aggregate or calibrate differently.

    Raises:
        ValueError: If aggregate, threshold or alpha differ.
    """
    kinds = {(log.document.aggregator, log.document.threshold, log.document.alpha): log.label for log in logs}
    if len(kinds) > 1:
        shown = "; ".join(f"{label}: {a}, {t} at {alpha:g}" for (a, t, alpha), label in kinds.items())
        raise ValueError(
            f"the runs were scored by mixed monitors ({shown}), expected one aggregate, threshold and alpha: report "
            "them apart, or fit and score again"
        )


def episode_weights(log: AlarmLog, draws: int, seed: int) -> NDArray[np.float64]:
    """How often every episode occurs in each bootstrap replicate ``(draws, E)``."""
    return resample_weights(len(log.document.episodes), draws, np.random.default_rng(seed))


def replicates(
    log: AlarmLog, signal: str, weights: NDArray[np.float64], groups: Sequence[str] = GROUPS
) -> tuple[dict[str, float], dict[str, NDArray[np.float64]]]:
    """Values and bootstrap replicates ``(draws,)`` of every measure of one signal.

    Args:
        log: The alarm log.
        signal: The signal.
        weights: How often every episode occurs in each replicate ``(draws, E)``.
        groups: Which of :data:`GROUPS` to compute; false alarms only where the decisions are flagged.
    """
    success = log.success
    values: dict[str, float] = {}
    drawn: dict[str, NDArray[np.float64]] = {}
    if "auroc" in groups:
        traces = log.aggregates(signal)
        compared = {
            "auroc": compare_traces(traces, success, log.strata),
            "auroc_time_matched": compare_traces(traces, success),
            "auroc_whole": compare_scores(largest_aggregates(log, signal), success),
        }
        values |= {name: table.auroc for name, table in compared.items()}
        drawn |= {name: table.resampled(weights) for name, table in compared.items()}
    if "false_alarms" in groups and all(episode.flagged is not None for episode in log.document.episodes):
        counted = false_alarms(log, signal)
        values |= {name: float(rate) for name, rate in counted.rates().items()}
        drawn |= counted.rates(weights)
    if "detection" in groups:
        largest = largest_aggregates(log, signal)
        for rate in DETECTION_RATES:
            name = f"detected_{round(100 * rate)}"
            values[name] = detection_at(largest, success, rate).detected
            drawn[name] = np.full(len(weights), np.nan)
            for row, weight in enumerate(weights.astype(np.int64)):
                chosen = np.repeat(np.arange(len(success)), weight)
                drawn[name][row] = detection_at(largest[chosen], success[chosen], rate).detected
    return values, drawn


def percentile_interval(replicates: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Percentile interval of bootstrap replicates, undefined where more than 1 % of them are."""
    defined = replicates[np.isfinite(replicates)]
    undefined = replicates.size - defined.size
    if undefined > 0.01 * replicates.size:
        return Interval(float("nan"), float("nan"), level, undefined)
    low, high = np.quantile(defined, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high), level, undefined)
