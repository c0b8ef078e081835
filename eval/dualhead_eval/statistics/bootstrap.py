"""Intervals and tests over conditions: the paper's bootstrap and its equivalence test (sec:gate, sec:tost).

Conditions are the resampling unit and every replicate re-runs the whole aggregation order. Replicates without
capacity leave rho undefined; they are counted, and above 1% of them rho's interval is undefined as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run_statistics import ConditionSums

#: The frozen protocol's number of replicates and seed.
BOOTSTRAP_DRAWS = 2000
BOOTSTRAP_SEED = 20260802
#: Equivalence margin on rho.
MARGIN = 0.02
#: Share of undefined replicates above which an interval is undefined.
UNDEFINED_LIMIT = 0.01


@dataclass(frozen=True)
class Resamples:
    """Replicates of every run statistic, ``(draws,)`` by name."""

    values: dict[str, NDArray[np.float64]]

    @property
    def names(self) -> tuple[str, ...]:
        """The statistics available."""
        return tuple(self.values)

    def interval(self, name: str, level: float) -> Interval:
        """Percentile interval of a statistic, undefined when more than 1% of its replicates are."""
        replicates = self.values[name]
        defined = replicates[np.isfinite(replicates)]
        undefined = replicates.size - defined.size
        if undefined > UNDEFINED_LIMIT * replicates.size:
            return Interval(float("nan"), float("nan"), level, undefined)
        low, high = np.quantile(defined, [(1 - level) / 2, (1 + level) / 2])
        return Interval(float(low), float(high), level, undefined)


def bootstrap_p_value(resamples: Resamples, name: str) -> float:
    """Two-sided bootstrap p-value of a statistic against zero; NaN under the interval's rule of undefinedness.

    Twice the smaller tail of the replicates beyond zero, the observed sample counted as one replicate.
    """
    replicates = resamples.values[name]
    defined = replicates[np.isfinite(replicates)]
    if replicates.size - defined.size > UNDEFINED_LIMIT * replicates.size:
        return float("nan")
    beyond = min(int((defined <= 0).sum()), int((defined >= 0).sum()))
    return min(1.0, 2 * (1 + beyond) / (1 + defined.size))


def p_value_floor(resamples: Resamples, name: str) -> float:
    """The p-value where no replicate lies on the other side of zero: more replicates could only lower it."""
    return 2 / (1 + int(np.isfinite(resamples.values[name]).sum()))


def resample_weights(n: int, draws: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """How often each of ``n`` units occurs in each of ``draws`` bootstrap samples, ``(draws, n)``."""
    chosen = rng.integers(0, n, size=(draws, n))
    flat = chosen + np.arange(draws)[:, None] * n
    return np.bincount(flat.ravel(), minlength=draws * n).reshape(draws, n).astype(np.float64)


def bootstrap_conditions(
    sums: ConditionSums, *, draws: int = BOOTSTRAP_DRAWS, rng: np.random.Generator | None = None
) -> Resamples:
    """Resample conditions (or clusters, after :meth:`ConditionSums.grouped`) and re-run the whole order.

    Args:
        sums: Terms of each condition.
        draws: Number of replicates.
        rng: Source of randomness; the frozen protocol's seed by default.
    """
    if draws < 1:
        raise ValueError(f"draws={draws}, expected at least 1: the frozen protocol uses {BOOTSTRAP_DRAWS}")
    rng = np.random.default_rng(BOOTSTRAP_SEED) if rng is None else rng
    weights = resample_weights(len(sums.terms), draws, rng)
    return Resamples(sums.statistics(weights @ sums.terms))


@dataclass(frozen=True)
class Equivalence:
    """Two one-sided tests of rho against zero, at 5%, from the 90% percentile interval.

    Attributes:
        margin: The band tested, +-margin on rho.
        interval: 90% interval of rho.
        width: Smallest band that the data support, max(|low|, |high|).
        equivalent: True or False, None where rho is undefined.
    """

    margin: float
    interval: Interval
    width: float
    equivalent: bool | None

    @property
    def verdict(self) -> str:
        """The decision in words."""
        if self.equivalent is None:
            return "undefined"
        return f"zero within {self.margin:.0%}" if self.equivalent else f"not within {self.margin:.0%}"


def equivalence_test(resamples: Resamples, *, margin: float = MARGIN) -> Equivalence:
    """TOST on rho (sec:tost): equivalent if the 90% interval lies strictly inside +-margin.

    Raises:
        ValueError: If the margin is not positive.
    """
    if not margin > 0:
        raise ValueError(f"margin={margin}, expected a positive band on rho, for example {MARGIN}")
    interval = resamples.interval("rho", 0.90)
    if np.isnan(interval.low):
        return Equivalence(margin, interval, float("nan"), None)
    width = interval.largest_magnitude
    return Equivalence(margin, interval, width, width < margin)
