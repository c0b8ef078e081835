"""A one-sided conformal band over time (Diquigiovanni, Fontana and Vantini 2022), as in FAIL-Detect.

Half of the calibration episodes give a centre m(t) and a modulation s(t), the others the largest of
(x(t) - m(t)) / s(t), whose k-th smallest q makes the band m(t) + q s(t). As the two halves are disjoint, a further
success leaves the band at any time with probability at most alpha.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.thresholds.threshold import Threshold, Trace, conformal_quantile, needed_episodes

MODULATIONS = ("const", "stdev", "tfunc")
#: Smallest modulation relative to the largest, so that a moment without spread does not decide alone.
FLOOR = 1e-3


class FunctionalBand(Threshold):
    """A limit per decision; beyond the longest episode of the first half its last value is held.

    Args:
        modulation: ``"const"`` 1; ``"stdev"`` the standard deviation at t; ``"tfunc"`` the largest deviation at t among
            the episodes of the first half whose own largest deviation is within its (1 - alpha) quantile.

    Raises:
        ValueError: If there is no such modulation.
    """

    name = "band"

    def __init__(self, modulation: str = "tfunc") -> None:
        if modulation not in MODULATIONS:
            raise ValueError(f"modulation {modulation!r} is not known, expected one of {MODULATIONS}")
        self.modulation = modulation
        self.limits: NDArray[np.float64] = np.empty(0)
        self.guarantee = "not fitted"

    def fit(self, traces: Sequence[Trace], alpha: float, rng: np.random.Generator) -> None:
        """Split the episodes at random, centre and modulate on one half, calibrate on the other.

        Raises:
            ValueError: If there are fewer than four episodes.
        """
        values = [trace.values for trace in traces if trace.values.size]
        if len(values) < 4:
            raise ValueError(
                f"{len(values)} calibration episodes, expected at least 4: the band uses two disjoint parts"
            )
        order = rng.permutation(len(values))
        # The calibrating half keeps enough episodes for a finite quantile where that is possible at all.
        second = max(len(values) // 2, min(needed_episodes(alpha), len(values) - 2))
        first = [values[i] for i in order[second:]]
        centre, scale = self._centre_and_scale(first, alpha)
        ratios = [self._largest_ratio(values[i], centre, scale) for i in order[:second]]
        self.limits = centre + conformal_quantile(ratios, alpha) * scale
        self.guarantee = f"a further success leaves the band at any time with probability at most {alpha:g}"

    def _centre_and_scale(self, episodes: list[NDArray], alpha: float) -> tuple[NDArray, NDArray]:
        longest = max(map(len, episodes))
        grid = np.full((len(episodes), longest), np.nan)
        for row, episode in zip(grid, episodes, strict=True):
            row[: len(episode)] = np.where(np.isfinite(episode), episode, np.nan)
        alive = np.isfinite(grid)
        count = np.maximum(alive.sum(axis=0), 1)
        centre = np.where(alive, grid, 0).sum(axis=0) / count
        deviation = np.where(alive, np.abs(grid - centre), 0.0)
        if self.modulation == "const":
            scale = np.ones(longest)
        elif self.modulation == "stdev":
            scale = np.sqrt((deviation**2).sum(axis=0) / np.maximum(count - 1, 1))
        else:
            largest = deviation.max(axis=1)
            scale = deviation[largest <= np.quantile(largest, 1 - alpha, method="inverted_cdf")].max(axis=0)
        widest = scale.max()
        return centre, np.maximum(scale, FLOOR * widest) if widest > 0 else np.ones(longest)

    @staticmethod
    def _largest_ratio(values: NDArray, centre: NDArray, scale: NDArray) -> float:
        held = np.minimum(np.arange(len(values)), len(centre) - 1)
        return float(((values - centre[held]) / scale[held]).max())

    def needed(self, alpha: float) -> int:
        """Two episodes more: the centre needs its own."""
        return needed_episodes(alpha) + 2

    def at(self, index: int, flagged: bool | None = None) -> float:
        """The band at decision ``index``."""
        return float(self.limits[min(index, len(self.limits) - 1)])

    def options(self) -> dict[str, Any]:
        """The modulation."""
        return {"modulation": self.modulation}

    def learned(self) -> dict[str, NDArray]:
        """The limits by decision."""
        return {"limits": self.limits}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take the limits back."""
        self.limits = arrays["limits"]
