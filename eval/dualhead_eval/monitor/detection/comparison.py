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


@dataclass(frozen=True)
class Measure:
    """A number with its 95% percentile interval over episodes."""

    value: float
    interval: Interval


def measures(
    log: AlarmLog, signal: str, *, draws: int = BOOTSTRAP_DRAWS, seed: int = BOOTSTRAP_SEED
) -> dict[str, Measure]:
    """Every measure of one signal, with intervals; false alarms only where the decisions are flagged."""
    values, replicates = _replicates(log, signal, draws, seed)
    return {name: Measure(values[name], _interval(replicates[name])) for name in values}


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
    ours, ours_drawn = _replicates(first, signal, draws, seed)
    theirs, theirs_drawn = _replicates(second, second_signal or signal, draws, seed)
    return {
        name: Measure(ours[name] - theirs[name], _interval(ours_drawn[name] - theirs_drawn[name]))
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


def _replicates(
    log: AlarmLog, signal: str, draws: int, seed: int
) -> tuple[dict[str, float], dict[str, NDArray[np.float64]]]:
    """Values and bootstrap replicates ``(draws,)`` of every measure."""
    success = log.success
    weights = resample_weights(len(success), draws, np.random.default_rng(seed))
    traces = log.aggregates(signal)
    primary = compare_traces(traces, success, log.strata)
    matched = compare_traces(traces, success)
    largest = largest_aggregates(log, signal)
    whole = compare_scores(largest, success)
    compared = {"auroc": primary, "auroc_time_matched": matched, "auroc_whole": whole}
    values = {name: table.auroc for name, table in compared.items()}
    replicates = {name: table.resampled(weights) for name, table in compared.items()}
    if all(episode.flagged is not None for episode in log.document.episodes):
        counted = false_alarms(log, signal)
        values |= {name: float(rate) for name, rate in counted.rates().items()}
        replicates |= counted.rates(weights)
    for rate in DETECTION_RATES:
        name = f"detected_{round(100 * rate)}"
        values[name] = detection_at(largest, success, rate).detected
        drawn = np.full(draws, np.nan)
        for row, weight in enumerate(weights.astype(np.int64)):
            chosen = np.repeat(np.arange(len(success)), weight)
            drawn[row] = detection_at(largest[chosen], success[chosen], rate).detected
        replicates[name] = drawn
    return values, replicates


def _interval(replicates: NDArray[np.float64]) -> Interval:
    defined = replicates[np.isfinite(replicates)]
    undefined = replicates.size - defined.size
    if undefined > 0.01 * replicates.size:
        return Interval(float("nan"), float("nan"), 0.95, undefined)
    low, high = np.quantile(defined, [0.025, 0.975])
    return Interval(float(low), float(high), 0.95, undefined)
