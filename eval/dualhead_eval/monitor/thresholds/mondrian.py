"""Mondrian thresholds: one where two modes are open, one elsewhere, each with its own guarantee."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.thresholds.conformal import UNITS, unit_scores
from dualhead_eval.monitor.thresholds.threshold import Threshold, Trace, conformal_quantile


class Mondrian(Threshold):
    """Split conformal within flagged and within other decisions.

    Args:
        unit: As in :class:`~dualhead_eval.monitor.thresholds.conformal.SplitConformal`, within each group.

    Raises:
        ValueError: If there is no such unit.
    """

    name = "mondrian"

    def __init__(self, unit: str = "episode") -> None:
        if unit not in UNITS:
            raise ValueError(f"unit {unit!r} is not known, expected one of {sorted(UNITS)}: choose one of these")
        self.unit = unit
        self.limits = {False: nan, True: nan}
        self.guarantee = "not fitted"

    def fit(self, traces: Sequence[Trace], alpha: float, rng: np.random.Generator) -> None:
        """Calibrate each group on the episodes that have decisions in it.

        Raises:
            ValueError: If the decisions are not flagged, or too few episodes have decisions in a group.
        """
        for group in self.limits:
            parts = []
            for trace in traces:
                if trace.flagged is None:
                    raise ValueError(
                        "a Mondrian threshold needs flagged decisions, expected --flag-data: give the training split "
                        "that says where two modes are open"
                    )
                parts.append(Trace(trace.values[trace.flagged == group]))
            held, needed = sum(part.values.size > 0 for part in parts), self.needed(alpha)
            if held < needed:
                raise ValueError(
                    f"{held} calibration episodes have decisions with the flag {str(group).lower()}, expected at least "
                    f"{needed} for alpha {alpha:g}: record more, raise alpha, or use another threshold"
                )
            self.limits[group] = conformal_quantile(unit_scores(parts, self.unit, rng), alpha)
        self.guarantee = "within flagged and within other decisions each: " + UNITS[self.unit].format(alpha=alpha)

    def at(self, index: int, flagged: bool | None = None) -> float:
        """The limit of the decision's group.

        Raises:
            ValueError: If the decision is not flagged.
        """
        if flagged is None:
            raise ValueError("a Mondrian threshold was given a decision without a flag, expected true or false")
        return self.limits[bool(flagged)]

    def options(self) -> dict[str, Any]:
        """The unit."""
        return {"unit": self.unit}

    def learned(self) -> dict[str, NDArray]:
        """The limits of other and of flagged decisions."""
        return {"limits": np.array([self.limits[False], self.limits[True]])}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take the limits back."""
        self.limits = dict(zip((False, True), map(float, arrays["limits"]), strict=True))
