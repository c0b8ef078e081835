"""The largest deviation of any observed dimension from its training mean: the simplest out-of-distribution score."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal, stacked_observations
from dualhead_policy.processor_dualhead import OBSERVATION_STD_FLOOR

#: Standard deviation below which a dimension counts as constant, in its own unit (m, rad, 1): that below which the
#: policy does not scale an observation either (the hand's tilt in the demonstrations, single precision's error).
CONSTANT = OBSERVATION_STD_FLOOR


class LargestDeviation(Signal):
    """max_d |o_d - mu_d| / sigma_d on the raw observation, before any clamp; constant dimensions are left out."""

    name, unit, needs, learns = "max_abs_z", "sd", frozenset({"observation"}), True

    def __init__(self) -> None:
        self.mean: NDArray[np.float64] | None = None
        self.scale: NDArray[np.float64] | None = None

    def fit(self, decisions: Sequence[Decision], rng: np.random.Generator) -> None:
        """Take mean and standard deviation (n - 1) of every dimension."""
        observations = stacked_observations(decisions)
        self.mean, scale = observations.mean(axis=0), observations.std(axis=0, ddof=min(1, len(observations) - 1))
        self.scale = np.where(scale >= CONSTANT, scale, np.inf)
        if not np.isfinite(self.scale).any():
            raise ValueError("max_abs_z found no dimension that varies, expected observations of several states")

    @property
    def left_out(self) -> NDArray[np.int64]:
        """Indices of the constant dimensions."""
        assert self.scale is not None
        return np.flatnonzero(~np.isfinite(self.scale))

    def score(self, decision: Decision) -> float:
        """The largest deviation in standard deviations."""
        if self.mean is None or self.scale is None:
            raise ValueError("max_abs_z has not been fitted, expected a call of fit before the first score")
        return float((np.abs(decision.observation - self.mean) / self.scale).max())

    def learned(self) -> dict[str, NDArray]:
        """Means, and standard deviations (infinite where left out)."""
        if self.mean is None or self.scale is None:
            return {}
        return {"mean": self.mean, "scale": self.scale}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take both back."""
        self.mean, self.scale = arrays["mean"], arrays["scale"]
