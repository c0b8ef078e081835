"""Detection at a realised rate of false alarms, horizons, and delays with misses censored."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import NDArray
from scipy.stats import CensoredData, ecdf

from dualhead_eval.monitor.detection.alarm_log import AlarmLog

#: Decisions after which the paper's horizon table looks.
HORIZONS = (6, 9, 12, 15, 18)


@dataclass(frozen=True)
class Detection:
    """Failures detected when the limit lets a given share of successes raise a false alarm.

    Attributes:
        limit: The smallest limit on an episode's largest aggregate that keeps the rate.
        realised: Share of successes above it, at most the rate asked for.
        detected: Share of failures above it.
    """

    limit: float
    realised: float
    detected: float


def detection_at(largest: NDArray[np.float64], success: NDArray[np.bool_], rate: float) -> Detection:
    """Detection from the largest aggregate of every episode ``(E,)``, NaN without successes or failures."""
    nominal, failed = np.sort(largest[success]), largest[~success]
    if not nominal.size or not failed.size:
        return Detection(float("nan"), float("nan"), float("nan"))
    limit = nominal[nominal.size - 1 - min(nominal.size - 1, floor(rate * nominal.size + 1e-9))]
    return Detection(float(limit), float((nominal > limit).mean()), float((failed > limit).mean()))


def largest_aggregates(log: AlarmLog, signal: str) -> NDArray[np.float64]:
    """The largest aggregate of every episode ``(E,)``."""
    return np.array([values.max() for values in log.aggregates(signal)])


@dataclass(frozen=True)
class Delays:
    """Steps from onset to the first alarm at or after it, over the failures that have an onset.

    Attributes:
        steps: Delay of a detected failure, steps to the end of a missed one ``(F,)``.
        detected: Whether it was detected ``(F,)``.
        lead: Steps from the alarm to the end of the episode, of the detected ones.
        early: Failures whose limit was exceeded before the onset already: a false alarm, whatever came later.
    """

    steps: NDArray[np.float64]
    detected: NDArray[np.bool_]
    lead: NDArray[np.float64]
    early: int

    def missed_after(self, steps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share not yet detected so many steps after the onset (Kaplan and Meier 1958); misses are censored."""
        data = CensoredData(uncensored=self.steps[self.detected], right=self.steps[~self.detected])
        return np.asarray(ecdf(data).sf.evaluate(np.asarray(steps, dtype=np.float64)))


def delays(log: AlarmLog, signal: str, limit: float | None = None) -> Delays:
    """Delays under the fitted limit, or under another one for all decisions."""
    steps, detected, lead, early = [], [], [], 0
    if limit is None:
        marks = log.exceeded(signal)
    else:
        marks = [values > limit for values in log.aggregates(signal)]
    for episode, alarm in zip(log.document.episodes, marks, strict=True):
        if episode.success or episode.onset is None:
            continue
        at = np.array(episode.at)
        early += bool(alarm[at < episode.onset].any())
        alarms = at[alarm & (at >= episode.onset)]
        detected.append(bool(alarms.size))
        steps.append(float(alarms[0] - episode.onset if alarms.size else max(0, episode.steps - episode.onset)))
        if alarms.size:
            lead.append(float(episode.steps - alarms[0]))
    return Delays(np.array(steps), np.array(detected, dtype=bool), np.array(lead), early)


def at_horizon(log: AlarmLog, signal: str, decisions: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Aggregate after so many decisions, and success, of the episodes that make as many."""
    alive = [(values[decisions - 1], episode.success)
             for values, episode in zip(log.aggregates(signal), log.document.episodes, strict=True)
             if len(values) >= decisions]  # fmt: skip
    return np.array([value for value, _ in alive]), np.array([success for _, success in alive], dtype=bool)
