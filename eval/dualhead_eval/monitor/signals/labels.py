"""Shares of a decision's pairs that chose two modes, reached none, or diverged: they ride along, never as alarms."""

from __future__ import annotations

import numpy as np

from dualhead_eval.effects.counts import INVALID
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal


class _LabelShare(Signal):
    unit, needs = "1", frozenset({"pairs", "labels"})

    def _labels(self, decision: Decision) -> np.ndarray:
        if decision.labels is None:
            raise ValueError(
                f"{self.name} needs mode labels, expected an environment with a mode partition: leave it out elsewhere"
            )
        return decision.labels


class Mismatch(_LabelShare):
    """Share of both-valid pairs whose heads chose different modes; 0 where no pair is valid."""

    name = "mismatch"

    def score(self, decision: Decision) -> float:
        """Observed mismatch of the decision."""
        a, b = self._labels(decision)
        both = (a != INVALID) & (b != INVALID)
        return float((a != b)[both].mean()) if both.any() else 0.0


class Invalid(_LabelShare):
    """Share of pairs in which a head reached no mode."""

    name = "invalid"

    def score(self, decision: Decision) -> float:
        """Share of invalid pairs."""
        return float((self._labels(decision) == INVALID).any(axis=0).mean())


class Diverged(Signal):
    """Share of pairs whose chunks left the training range or are not finite."""

    name, unit, needs = "diverged", "1", frozenset({"pairs"})

    def score(self, decision: Decision) -> float:
        """Share of diverged pairs."""
        a, b = decision.pair
        broken = ~(np.isfinite(a).all(axis=(1, 2)) & np.isfinite(b).all(axis=(1, 2)))
        return float((broken if decision.diverged is None else broken | decision.diverged).mean())


class Elapsed(Signal):
    """Steps since the episode began: the control that any signal must beat."""

    name, unit, needs = "elapsed", "step", frozenset()

    def score(self, decision: Decision) -> float:
        """The decision's step."""
        return float(decision.step)
