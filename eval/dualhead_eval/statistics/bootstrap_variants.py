"""Bootstrap intervals beside the paper's percentile ones: BCa and studentised (Efron and Tibshirani, 1993).

Percentile intervals are the protocol's. BCa corrects them for bias and skew, the studentised interval for a
standard error that varies with the value; both use the same resampling of conditions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from dualhead_eval.statistics.bootstrap import (
    BOOTSTRAP_DRAWS,
    BOOTSTRAP_SEED,
    UNDEFINED_LIMIT,
    bootstrap_conditions,
    resample_weights,
)
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run_statistics import TERMS, ConditionSums

#: Statistics that are ratios of two sums over conditions: (numerator, denominator) columns of the terms.
_RATIOS = {name: (name, "weight") for name in ("obs", "bl", "delta", "capacity", "capacity_tight")}
_RATIOS |= {"valid_rate": ("both_valid", "sampled"), "rho": ("delta", "capacity")}
#: Those that stay one under the unbiased estimator, whose capacity is a product of two means.
_UNBIASED_RATIOS = {"obs", "bl", "delta", "valid_rate"}


def bca_interval(
    sums: ConditionSums,
    name: str,
    level: float = 0.95,
    *,
    draws: int = BOOTSTRAP_DRAWS,
    rng: np.random.Generator | None = None,
) -> Interval:
    """Bias-corrected and accelerated interval of any run statistic, from the frozen protocol's resamples.

    Undefined (NaN) under the percentile interval's rule, or where all replicates are equal.
    """
    replicates = bootstrap_conditions(sums, draws=draws, rng=rng).values[name]
    defined = replicates[np.isfinite(replicates)]
    undefined = replicates.size - defined.size
    nowhere = Interval(float("nan"), float("nan"), level, undefined)
    if undefined > UNDEFINED_LIMIT * replicates.size:
        return nowhere
    total = sums.total()
    estimate = sums.statistics(total)[name]
    left_out = sums.statistics(total - sums.terms)[name]
    centred = left_out[np.isfinite(left_out)].mean() - left_out[np.isfinite(left_out)]
    spread = (centred**2).sum() ** 1.5
    # Ties count one half, so that a discrete statistic is not biased by its own value.
    below = ((defined < estimate).sum() + 0.5 * (defined == estimate).sum()) / defined.size
    if spread == 0 or not 0 < below < 1:
        return nowhere
    acceleration = (centred**3).sum() / (6 * spread)
    bias = norm.ppf(below)
    z = bias + norm.ppf([(1 - level) / 2, (1 + level) / 2])
    low, high = np.quantile(defined, norm.cdf(bias + z / (1 - acceleration * z)))
    return Interval(float(low), float(high), level, undefined)


def standard_error(sums: ConditionSums, name: str) -> float:
    """Linearised standard error, over conditions, of a statistic that is a ratio of sums (rho, delta, ...).

    Raises:
        KeyError: If the statistic is not such a ratio (the pooled ones).
    """
    return float(_ratio_and_error(sums, name, np.ones((1, len(sums.terms))))[1][0])


def studentised_interval(
    sums: ConditionSums,
    name: str,
    level: float = 0.95,
    *,
    draws: int = BOOTSTRAP_DRAWS,
    rng: np.random.Generator | None = None,
) -> Interval:
    """Bootstrap-t interval of a statistic that is a ratio of sums over conditions.

    Raises:
        KeyError: If the statistic is not such a ratio (the pooled ones).
    """
    rng = np.random.default_rng(BOOTSTRAP_SEED) if rng is None else rng
    estimate, error = (x[0] for x in _ratio_and_error(sums, name, np.ones((1, len(sums.terms)))))
    values, errors = _ratio_and_error(sums, name, resample_weights(len(sums.terms), draws, rng))
    usable = np.isfinite(values) & (errors > 0)
    undefined = draws - int(usable.sum())
    if undefined > UNDEFINED_LIMIT * draws:
        return Interval(float("nan"), float("nan"), level, undefined)
    t = (values[usable] - estimate) / errors[usable]
    low, high = np.quantile(t, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(estimate - high * error), float(estimate - low * error), level, undefined)


def _ratio_and_error(sums: ConditionSums, name: str, weights: NDArray) -> tuple[NDArray, NDArray]:
    """The ratio and its linearised standard error for each row of ``weights`` over conditions."""
    ratios = set(_RATIOS) if sums.estimator == "plug-in" else _UNBIASED_RATIOS
    if name not in ratios:
        raise KeyError(f"{name!r} is not a ratio of sums, expected one of {sorted(ratios)}: use bca_interval")
    numerator, denominator = (sums.terms[:, TERMS.index(column)] for column in _RATIOS[name])
    top, bottom = weights @ numerator, weights @ denominator
    missing = np.full(top.shape, np.nan)
    ratio = np.divide(top, bottom, out=missing.copy(), where=bottom > 0)
    squares = weights @ numerator**2 - 2 * ratio * (weights @ (numerator * denominator))
    squares = squares + ratio**2 * (weights @ denominator**2)
    error = np.divide(np.sqrt(np.maximum(squares, 0)), bottom, out=missing, where=bottom > 0)
    return ratio, error
