"""Bounds on a running mean that hold at every moment, for observations whose mean may drift.

Howard, Ramdas, McAuliffe and Sekhon (Annals of Statistics, 2021), Theorem 4: let X_t lie in [a, b] and let
guess_t be any prediction of X_t from the past. With V_t = sum (X_i - guess_i)^2, the sum of X_i minus their
conditional means is sub-exponential with scale c = b - a and variance process V_t. Any sub-exponential
uniform boundary u then gives

    P(for all t: |mean of X_1..X_t - mean of the conditional means| < u(V_t) / t) >= 1 - 2 alpha.

The conditional means may change with time and depend on the past. The boundary is the gamma-exponential
mixture of their Proposition 9: not asymptotic, no tuning beyond where it is tightest.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammainc, gammaln

#: Observations after which the boundary is about tightest.
TUNED_OBSERVATIONS = 1000
#: Their variance process if each is one draw of a fair coin, the largest in [0, 1].
TUNED_VARIANCE = TUNED_OBSERVATIONS / 4


def tuned_variance(pairs: int) -> float:
    """Variance process at which bounds on decisions of ``pairs`` sample pairs should be tightest.

    Matched against mismatched pairs of two independent, even heads have variance 1 / 4(n - 1); it is known
    before the first label, as the boundary's guarantee needs.
    """
    return TUNED_VARIANCE / max(1, pairs - 1)


def log_mixture(s: ArrayLike, v: ArrayLike, scale: float, rho: float) -> NDArray[np.float64]:
    """Logarithm of the gamma-exponential mixture martingale at deviation ``s`` >= 0 and variance ``v``.

    The boundary at level alpha is crossed when this reaches log(1 / alpha).
    """
    s, v = np.asarray(s, dtype=np.float64), np.asarray(v, dtype=np.float64)
    squared = scale**2
    start = rho / squared
    a = (v + rho) / squared
    x = (scale * s + v + rho) / squared
    value = start * log(start) - gammaln(start) - np.log(gammainc(start, start))
    return value + gammaln(a) + np.log(gammainc(a, x)) - a * np.log(x) + (x - start)


def mixture_rho(alpha: float, variance: float = TUNED_VARIANCE) -> float:
    """Mixture parameter for which the boundary is about tightest at ``variance``."""
    level = 2 * log(1 / alpha)
    return variance / (level + log(1 + level))


def boundary(v: float, alpha: float, scale: float, variance: float = TUNED_VARIANCE) -> float:
    """Deviation u(v) that a sum exceeds at any time with probability at most ``alpha`` (one side).

    Args:
        v: Variance process so far.
        alpha: One-sided crossing probability, in (0, 1).
        scale: Range b - a of an observation.
        variance: Where the boundary is tightest.
    """
    rho, squared = mixture_rho(alpha, variance), scale**2
    target = log(1 / alpha)
    start, a = rho / squared, (v + rho) / squared
    fixed = start * log(start) - lgamma(start) - log(gammainc(start, start)) + lgamma(a) - start - target

    def excess(s: float) -> float:
        # log_mixture of one deviation, without array overhead.
        x = a + s / scale
        return fixed + log(gammainc(a, x)) - a * log(x) + x

    # No smaller deviation can cross, since the mixture is at most exp(s^2 / 2v).
    low = sqrt(2 * v * target)
    high = low + scale * target
    below = excess(low)
    while (above := excess(high)) < 0:
        low, below, high = high, above, 2 * high
    if below >= 0:
        return low
    # Regula falsi, Illinois variant: an end that stays twice counts half.
    side = 0
    while high - low > 1e-9 * high:
        middle = (low * above - high * below) / (above - below)
        value = excess(middle)
        if abs(value) < 1e-10:
            return middle
        if value < 0:
            low, below = middle, value
            above = 0.5 * above if side < 0 else above
            side = -1
        else:
            high, above = middle, value
            below = 0.5 * below if side > 0 else below
            side = 1
    return high


@dataclass
class RunningMean:
    """A running mean of observations in [low, high] with time-uniform bounds; three numbers of memory.

    Attributes:
        low: Smallest possible observation.
        high: Largest possible observation.
        count: Observations so far.
        total: Their sum.
        variance: V, the sum of squared prediction errors.
    """

    low: float
    high: float
    count: int = 0
    total: float = 0.0
    variance: float = 0.0

    @property
    def mean(self) -> float:
        """Mean of the observations, NaN before the first."""
        return self.total / self.count if self.count else float("nan")

    def add(self, x: float) -> None:
        """Add one observation."""
        guess = (self.total + 0.5 * (self.low + self.high)) / (self.count + 1)
        self.variance += (x - guess) ** 2
        self.total += x
        self.count += 1

    def add_many(self, x: NDArray[np.float64]) -> None:
        """Add observations in their order, each predicted from those before it."""
        if not x.size:
            return
        before = self.total + np.cumsum(x) - x
        guess = (before + 0.5 * (self.low + self.high)) / (self.count + 1 + np.arange(x.size))
        self.variance += float(((x - guess) ** 2).sum())
        self.total += float(x.sum())
        self.count += x.size

    def merge(self, other: RunningMean) -> None:
        """Add another stream's observations.

        The bounds stay valid: the product of the streams' supermartingales is one for the streams interleaved
        as they happened, with both variance processes added.
        """
        self.count += other.count
        self.total += other.total
        self.variance += other.variance

    def bounds(self, alpha: float, tuned: float = TUNED_VARIANCE) -> tuple[float, float]:
        """Bounds on the mean of the conditional means, both missed at any time with probability <= alpha.

        Args:
            alpha: Probability that either bound ever fails.
            tuned: Variance process at which they are about tightest; chosen before the first observation.
        """
        if self.count == 0:
            return self.low, self.high
        width = boundary(self.variance, alpha / 2, self.high - self.low, tuned) / self.count
        return max(self.low, self.mean - width), min(self.high, self.mean + width)
