"""False alarms from three numbers: the flagged share f, the mismatch share x, and the residuals of demonstrations.

Calibration decisions are mismatched with probability f x. With S_0 and S_c the survival functions of the residual
within and across modes, the threshold t and the gap of false alarms between flagged and other decisions are

    f x S_c(t) + (1 - f x) S_0(t) = alpha,    gap = x (S_c(t) - S_0(t)).

Where modes are far apart, S_c is 1 up to the cloud of mismatched pairs: while f x < alpha, t stays near the floor and
the gap near x; beyond, t climbs into the cloud and the gap is alpha / f for any x.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dualhead_envs.ring.generator import RingGenerator
from dualhead_eval.residuals.distances import position_residual_mm

#: Pairs of demonstrations behind each survival function: a share of .05 has a standard error of .0007.
PAIRS = 100_000


@dataclass(frozen=True)
class Predicted:
    """Threshold in mm, and the shares of flagged and other decisions beyond it."""

    threshold: float
    flagged: float
    other: float

    @property
    def gap(self) -> float:
        """Flagged less other."""
        return self.flagged - self.other


@dataclass(frozen=True)
class ResidualLaw:
    """Sorted residuals in mm of pairs of paths within a mode and across the two modes."""

    within: NDArray[np.float64]
    across: NDArray[np.float64]

    def predict(self, flagged_share: float, mismatch: float, alpha: float) -> Predicted:
        """Threshold and false alarms at a flagged share f and a mismatch share x."""
        mixed = flagged_share * mismatch

        def excess(t: float) -> float:
            return mixed * _beyond(self.across, t) + (1 - mixed) * _beyond(self.within, t) - alpha

        t = float(brentq(excess, 0.0, 1.0 + max(self.within[-1], self.across[-1]), xtol=1e-6))
        other = _beyond(self.within, t)
        return Predicted(t, mismatch * _beyond(self.across, t) + (1 - mismatch) * other, other)


@lru_cache(maxsize=16)
def demonstrated_residuals(mode_angle: float, pairs: int = PAIRS) -> ResidualLaw:
    """Residuals between demonstrations under one condition, whose modes lie ``mode_angle`` radians apart."""
    generator = RingGenerator(2, angles=[0.0, mode_angle])
    rng = np.random.default_rng(0)
    conditions = generator.draw_conditions(rng, pairs)
    first, second = np.zeros(pairs, dtype=np.int64), np.ones(pairs, dtype=np.int64)
    path = generator.draw_paths(rng, conditions, first)
    within = position_residual_mm(path, generator.draw_paths(rng, conditions, first))
    across = position_residual_mm(path, generator.draw_paths(rng, conditions, second))
    return ResidualLaw(np.sort(within), np.sort(across))


def _beyond(ordered: NDArray[np.float64], t: float) -> float:
    return float(1 - np.searchsorted(ordered, t, side="right") / ordered.size)
