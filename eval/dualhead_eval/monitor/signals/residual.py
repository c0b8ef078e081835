"""The reconciled residual between two decodings, and three forms of it over several sampled pairs, in mm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal


def path_distances_mm(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """D(a_i, b_j) ``(n, m)``, the mean distance over the window in mm, of paths ``(n, H, d)``, ``(m, H, d)`` in m."""
    difference = a[:, None] - b[None]
    return 1000.0 * np.sqrt(np.einsum("ijhd,ijhd->ijh", difference, difference)).mean(axis=-1)


class Residual(Signal):
    """D(a_1, b_1): the two decodings of the executed pair."""

    name, unit, needs = "residual", "mm", frozenset({"pairs"})

    def score(self, decision: Decision) -> float:
        """Mean distance over the window, in mm."""
        a, b = decision.pair
        difference = a[0] - b[0]
        return float(1000.0 * np.sqrt(np.einsum("hd,hd->h", difference, difference)).mean())


class ExecutedResidual(Signal):
    """The residual over the executed steps alone, which is all that a processor step in LeRobot sees.

    Args:
        steps: Executed steps of a chunk, the policy's ``n_action_steps``.
    """

    name, unit, needs = "residual_executed", "mm", frozenset({"pairs"})

    def __init__(self, steps: int = 8) -> None:
        if steps < 1:
            raise ValueError(f"steps={steps}, expected at least 1")
        self.steps = steps

    def score(self, decision: Decision) -> float:
        """Mean distance over the executed steps, in mm."""
        a, b = decision.pair
        difference = a[0, : self.steps] - b[0, : self.steps]
        return float(1000.0 * np.sqrt(np.einsum("hd,hd->h", difference, difference)).mean())

    def options(self) -> dict[str, int]:
        """How many steps."""
        return {"steps": self.steps}


class ResidualMean(Signal):
    """mean_i D(a_i, b_i): the residual averaged over the sampled pairs."""

    name, unit, needs = "residual_mean", "mm", frozenset({"pairs", "samples"})

    def score(self, decision: Decision) -> float:
        """Mean distance over pairs and window, in mm."""
        a, b = decision.pair
        difference = a - b
        return float(1000.0 * np.sqrt(np.einsum("nhd,nhd->nh", difference, difference)).mean())


class MatchedResidual(Signal):
    """Half of mean_i min_j D(a_i, b_j) plus mean_j min_i D(a_i, b_j): every chunk beside its nearest of the other head.

    Two heads that choose their modes independently have a small matched residual as long as each mode was chosen by
    both, so it needs no coordination.
    """

    name, unit, needs = "residual_matched", "mm", frozenset({"pairs", "samples"})

    def score(self, decision: Decision) -> float:
        """Mean of the two directed nearest distances, in mm."""
        distances = path_distances_mm(*decision.pair)
        return float(0.5 * (distances.min(axis=1).mean() + distances.min(axis=0).mean()))


class EnergyResidual(Signal):
    """2 E D(a, b) - E D(a, a') - E D(b, b'), a U-statistic: how far apart the heads' distributions are.

    Of independent heads alike in distribution it is zero in the mean, and may be negative.
    """

    name, unit, needs = "residual_energy", "mm", frozenset({"pairs", "samples"})

    def score(self, decision: Decision) -> float:
        """The energy distance, unbiased, in mm; pairs (i, i) share a draw of what the heads share and are left out."""
        a, b = decision.pair
        n = len(a)
        if n < 2:
            raise ValueError("residual_energy needs two pairs per decision or more: record with --samples 8, say")
        off = ~np.eye(n, dtype=bool)
        across, within_a, within_b = (path_distances_mm(x, y)[off].mean() for x, y in ((a, b), (a, a), (b, b)))
        return float(2 * across - within_a - within_b)
