"""Spread of one head's samples: the trace of their covariance, averaged over the window."""

from __future__ import annotations

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal


class _Variance(Signal):
    unit, needs = "mm^2", frozenset({"pairs", "samples"})
    head: int

    def score(self, decision: Decision) -> float:
        """Mean over steps of the trace of the sample covariance (n - 1), in mm^2."""
        samples = decision.pair[self.head]
        return float(1e6 * samples.var(axis=0, ddof=1).sum(axis=-1).mean())


class PositionVariance(_Variance):
    """Spread of head B's chunks."""

    name, head = "variance_position", 1


class JointVariance(_Variance):
    """Spread of head A's chunks, as positions."""

    name, head = "variance_joint", 0
