"""Split conformal thresholds: one number, calibrated on episodes or on their decisions."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.thresholds.threshold import Threshold, Trace, conformal_quantile

#: What is exchangeable, and what the threshold then guarantees.
UNITS = {
    "episode": "a further success raises an alarm at any time with probability at most {alpha:g}",
    "random-step": "one random decision of a further success exceeds it with probability at most {alpha:g}",
    "paper-step": "none: the pooled decisions of an episode are not exchangeable (the paper's choice)",
}


class SplitConformal(Threshold):
    """One threshold for all decisions.

    Args:
        unit: ``"episode"``: the largest aggregate of each calibration episode; ``"random-step"``: the aggregate of one
            random decision of each; ``"paper-step"``: of all decisions pooled.

    Raises:
        ValueError: If there is no such unit.
    """

    name = "conformal"

    def __init__(self, unit: str = "episode") -> None:
        if unit not in UNITS:
            raise ValueError(f"unit {unit!r} is not known, expected one of {sorted(UNITS)}: choose one of these")
        self.unit = unit
        self.limit = nan
        self.guarantee = "not fitted"

    def fit(self, traces: Sequence[Trace], alpha: float, rng: np.random.Generator) -> None:
        """Take the k-th smallest calibration score."""
        self.limit = conformal_quantile(unit_scores(traces, self.unit, rng), alpha)
        self.guarantee = UNITS[self.unit].format(alpha=alpha)

    def at(self, index: int, flagged: bool | None = None) -> float:
        """The limit, the same at every decision."""
        return self.limit

    def options(self) -> dict[str, Any]:
        """The unit."""
        return {"unit": self.unit}

    def learned(self) -> dict[str, NDArray]:
        """The limit."""
        return {"limit": np.array([self.limit])}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take the limit back."""
        self.limit = float(arrays["limit"][0])


def unit_scores(traces: Sequence[Trace], unit: str, rng: np.random.Generator) -> NDArray[np.float64]:
    """The calibration scores of episodes: one each, or all decisions for ``"paper-step"``."""
    values = [trace.values for trace in traces if trace.values.size]
    if unit == "episode":
        return np.array([episode.max() for episode in values])
    if unit == "random-step":
        return np.array([episode[rng.integers(episode.size)] for episode in values])
    return np.concatenate(values) if values else np.empty(0)
