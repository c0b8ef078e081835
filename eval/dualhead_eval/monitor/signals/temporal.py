"""Consistency over time: do consecutive decisions predict the same motion on the steps that they share?

STAC (Sentinel): the maximum mean discrepancy between the samples of two decisions; in its cheap forms the distance of
the two executed chunks, and of the measured position from the last chunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal


def squared_mmd(x: NDArray[np.float64], y: NDArray[np.float64], bandwidth: float) -> float:
    """MMD^2 (V-statistic) of samples ``(n, D)`` and ``(m, D)`` under the kernel exp(-|x - y|^2 / 2 bandwidth^2)."""

    def kernel_mean(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
        squares = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
        return float(np.exp(-squares / (2 * bandwidth**2)).mean())

    return kernel_mean(x, x) + kernel_mean(y, y) - 2 * kernel_mean(x, y)


class _Remembering(Signal):
    def __init__(self) -> None:
        self.before: Decision | None = None

    def reset(self) -> None:
        """Forget the decision before."""
        self.before = None

    def score(self, decision: Decision) -> float:
        """The score against the decision before; 0 at an episode's first, which nothing contradicts."""
        before, self.before = self.before, decision
        if before is None:
            return 0.0
        return self.compare(before, decision, decision.step - before.step)

    def compare(self, before: Decision, after: Decision, executed: int) -> float:
        """The score of two decisions that lie ``executed`` steps apart."""
        raise NotImplementedError


class _SampleConsistency(_Remembering):
    unit, needs, learns = "1", frozenset({"pairs", "samples", "memory"}), True
    head: int

    def __init__(self) -> None:
        super().__init__()
        self.bandwidth: float | None = None

    def fit(self, decisions: Sequence[Decision], rng: np.random.Generator) -> None:
        """Freeze the bandwidth: the median distance between two samples of consecutive decisions' shared steps."""
        distances = []
        for before, after in pairwise(decisions):
            if after.step > before.step:
                x, y = self._shared(before, after, after.step - before.step)
                if x.shape[1]:
                    distances.append(np.linalg.norm(x[:, None] - y[None], axis=-1).ravel())
        if not distances:
            raise ValueError(
                f"{self.name} found no two consecutive decisions with shared steps, expected episodes of two decisions "
                "or more: execute fewer steps than the horizon"
            )
        self.bandwidth = max(float(np.nanmedian(np.concatenate(distances))), 1e-9)

    def compare(self, before: Decision, after: Decision, executed: int) -> float:
        """MMD^2 of the samples on the shared steps; 0 where the decisions share none."""
        if self.bandwidth is None:
            raise ValueError(f"{self.name} has not been fitted, expected a call of fit before the first score")
        x, y = self._shared(before, after, executed)
        return squared_mmd(x, y, self.bandwidth) if x.shape[1] else 0.0

    def _shared(self, before: Decision, after: Decision, executed: int) -> tuple[NDArray, NDArray]:
        x, y = before.pair[self.head], after.pair[self.head]
        shared = max(0, x.shape[1] - executed)
        return x[:, executed:].reshape(len(x), -1), y[:, :shared].reshape(len(y), -1)

    def learned(self) -> dict[str, NDArray]:
        """The bandwidth in m."""
        return {} if self.bandwidth is None else {"bandwidth": np.array([self.bandwidth])}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take the bandwidth back."""
        self.bandwidth = float(arrays["bandwidth"][0])


class PositionConsistency(_SampleConsistency):
    """STAC of head B's samples."""

    name, head = "stac_position", 1


class JointConsistency(_SampleConsistency):
    """STAC of head A's samples, as positions."""

    name, head = "stac_joint", 0


class ChunkConsistency(_Remembering):
    """Distance of consecutive executed chunks on the steps that they share."""

    name, unit, needs = "stac_single", "mm", frozenset({"pairs", "memory"})

    def compare(self, before: Decision, after: Decision, executed: int) -> float:
        """Mean distance on the shared steps, in mm; 0 where the chunks share none."""
        x = before.chunk[executed:]
        difference = x - after.chunk[: len(x)]
        return float(1000.0 * np.linalg.norm(difference, axis=-1).mean()) if len(x) else 0.0


class Tracking(_Remembering):
    """Distance of the measured position from where the last chunk wanted it by now."""

    name, unit, needs = "tracking", "mm", frozenset({"pairs", "memory", "observation"})

    def compare(self, before: Decision, after: Decision, executed: int) -> float:
        """Distance in mm; step h of a chunk is the position h + 1 steps after its decision."""
        if after.site is None:
            raise ValueError(
                "tracking needs the measured position, expected an observation that holds it: leave it out"
            )
        wanted = before.chunk[min(executed, len(before.chunk)) - 1]
        return float(1000.0 * np.linalg.norm(after.site - wanted))
