"""A monitor: signals of every decision, aggregated over the episode, against thresholds fitted on successes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dualhead_eval.monitor.aggregation import Aggregator
from dualhead_eval.monitor.decision import Decision, Episode
from dualhead_eval.monitor.signals.registry import make_signal
from dualhead_eval.monitor.signals.signal import Signal
from dualhead_eval.monitor.thresholds.registry import make_threshold
from dualhead_eval.monitor.thresholds.threshold import Threshold, Trace

#: Share of the calibration episodes that signals learn from; the others calibrate the thresholds.
LEARNING_SHARE = 1 / 3


@dataclass(frozen=True)
class Reading:
    """What a monitor says after a decision: about its first signal, and about each in ``by_signal``.

    Attributes:
        score: The decision's score, infinite if it is not finite.
        aggregate: The episode's aggregate so far.
        threshold: What the aggregate must exceed for an alarm.
        alarm: Whether it has exceeded it at any decision of the episode.
        step: Control step of the decision.
        by_signal: A reading of every signal by name.
    """

    score: float
    aggregate: float
    threshold: float
    alarm: bool
    step: int
    by_signal: Mapping[str, Reading] = field(default_factory=dict, repr=False)


@dataclass
class Channel:
    """One signal with its aggregate, its threshold and the state of its alarm."""

    signal: Signal
    aggregator: Aggregator
    threshold: Threshold
    alarm: bool = False

    def reset(self) -> None:
        """Begin an episode."""
        self.signal.reset()
        self.aggregator.reset()
        self.alarm = False

    def score(self, decision: Decision) -> tuple[float, float]:
        """Score and aggregate of one more decision."""
        with np.errstate(all="ignore"):  # what is not finite is counted as diverged, not warned about
            score = self.signal.score(decision)
        score = score if np.isfinite(score) else float("inf")
        return score, self.aggregator.add(score)


class Monitor:
    """Signals, aggregate and threshold; the first signal is the one that the monitor's alarm is about.

    >>> monitor = Monitor(["residual", "elapsed"], "ewma-max", "conformal:episode")
    >>> [channel.signal.name for channel in monitor.channels]
    ['residual', 'elapsed']

    Args:
        signals: Signals, or their names.
        aggregator: Name of the aggregate, see :mod:`dualhead_eval.monitor.aggregation`.
        threshold: Name of the threshold, see :mod:`dualhead_eval.monitor.thresholds.registry`; each signal has its own.

    Raises:
        ValueError: If there is no signal, two have one name, or a name is not known.
    """

    def __init__(
        self,
        signals: Sequence[Signal | str],
        aggregator: str = "ewma-max",
        threshold: str = "conformal:episode",
    ) -> None:
        made = [make_signal(signal) if isinstance(signal, str) else signal for signal in signals]
        names = [signal.name for signal in made]
        if not made or len(set(names)) < len(names):
            raise ValueError(f"signals {names} given, expected one or more, each once")
        self.channels = [Channel(signal, Aggregator(aggregator), make_threshold(threshold)) for signal in made]
        self.aggregator_name, self.threshold_name = aggregator, threshold
        self.alpha: float | None = None
        self.calibration: tuple[str, ...] = ()
        self._index, self._last_step = 0, -1

    @property
    def names(self) -> list[str]:
        """Names of the signals."""
        return [channel.signal.name for channel in self.channels]

    def fit(
        self,
        episodes: Sequence[Episode],
        alpha: float = 0.05,
        *,
        rng: np.random.Generator,
        training: Sequence[Decision] = (),
        allow_failures: bool = False,
    ) -> Monitor:
        """Let the signals learn and fit the thresholds, on disjoint episodes.

        Args:
            episodes: Nominal successes, none of which is used in a test.
            alpha: Rate of false alarms.
            rng: Source of the split, the random decisions and the networks.
            training: Decisions (observations suffice) of the policy's own training data, from which signals of the
                observation alone learn; those of predictions, or all if there is none, learn from a third of the
                episodes.
            allow_failures: Calibrate on failures too, which raises the thresholds.

        Returns:
            Itself.

        Raises:
            ValueError: If there is no episode, one failed, or too few are left for a finite threshold.
        """
        failed = [episode.key for episode in episodes if not episode.success]
        if failed and not allow_failures:
            raise ValueError(
                f"{len(failed)} of {len(episodes)} calibration episodes failed (the first: {failed[0]}), expected "
                "successes alone: leave them out, or ask for them with allow_failures"
            )
        from_episodes = [c for c in self.channels if c.signal.learns and not (_observes(c.signal) and training)]
        order = rng.permutation(len(episodes))
        learning = order[: int(len(episodes) * LEARNING_SHARE)] if from_episodes else order[:0]
        calibrating = [episodes[i] for i in order[len(learning) :]]
        needed = max(channel.threshold.needed(alpha) for channel in self.channels)
        if len(calibrating) < needed:
            raise ValueError(
                f"{len(calibrating)} successful episodes calibrate the threshold, expected at least "
                f"{needed} for alpha {alpha:g}"
                + (f" beside the {len(learning)} that signals learn from" if len(learning) else "")
                + ": record more, or raise alpha"
            )
        decisions = [decision for i in learning for decision in episodes[i].decisions]
        for channel in self.channels:
            if channel.signal.learns:
                channel.signal.fit(decisions if channel in from_episodes else training, rng)
        traces: list[list[Trace]] = [[] for _ in self.channels]
        for episode in calibrating:
            self.reset()
            values = np.array([[c.score(d)[1] for c in self.channels] for d in episode.decisions])
            flags = [decision.flagged for decision in episode.decisions]
            flagged = None if None in flags else np.array(flags, dtype=bool)
            for column, kept in zip(values.T, traces, strict=True):
                kept.append(Trace(column, flagged))
        for channel, kept in zip(self.channels, traces, strict=True):
            channel.threshold.fit(kept, alpha, rng)
        self.alpha, self.calibration = alpha, tuple(episode.key for episode in episodes)
        self.reset()
        return self

    def reset(self) -> None:
        """Begin an episode: forget its decisions, clear the alarms."""
        self._index, self._last_step = 0, -1
        for channel in self.channels:
            channel.reset()

    def update(self, decision: Decision) -> Reading:
        """Read one more decision of the episode.

        Raises:
            ValueError: If the monitor has not been fitted, the decision lacks what a signal needs, or does not come
                after the one before.
        """
        if self.alpha is None:
            raise ValueError("the monitor has no threshold yet, expected a call of fit with calibration episodes first")
        if decision.step <= self._last_step:
            raise ValueError(
                f"a decision at step {decision.step} follows one at step {self._last_step}, expected a later one: call "
                "reset when an episode begins"
            )
        self._last_step = decision.step
        readings = {}
        for channel in self.channels:
            score, aggregate = channel.score(decision)
            limit = channel.threshold.at(self._index, decision.flagged)
            channel.alarm = channel.alarm or aggregate > limit
            readings[channel.signal.name] = Reading(score, aggregate, limit, channel.alarm, decision.step)
        self._index += 1
        first = readings[self.names[0]]
        return Reading(first.score, first.aggregate, first.threshold, first.alarm, first.step, readings)

    def read(self, episode: Episode) -> list[Reading]:
        """Readings of a recorded episode, as the monitor would have given them beside the robot."""
        self.reset()
        return [self.update(decision) for decision in episode.decisions]


def _observes(signal: Signal) -> bool:
    return signal.needs == {"observation"}
