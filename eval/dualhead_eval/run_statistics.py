"""A run's statistics as functions of sums over conditions, so that resampling is a matrix product.

Every statistic of a run is a ratio of sums over conditions. :func:`condition_sums` computes the terms once
from each condition's own table; :func:`run_statistics` turns any weighted sum of them into the run's values.
A bootstrap replicate is then a vector of weights, and re-runs the whole order: per condition, weighted means,
ratio of the means.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.counts import both_valid
from dualhead_eval.effects import coordination, validate_counts

#: Leading columns of :attr:`ConditionSums.terms`; the pooled table's K^2 cells follow.
TERMS = ("sampled", "both_valid", "obs", "bl", "delta", "capacity", "capacity_tight")


@dataclass(frozen=True)
class ConditionSums:
    """Additive terms of each condition.

    Attributes:
        terms: ``(n_conditions, 7 + K^2)``: sampled pairs, both-valid pairs N, then N times obs, bl, delta,
            capacity and capacity_tight, then the both-valid counts themselves.
        n_modes: Number of modes K.
    """

    terms: NDArray[np.float64]
    n_modes: int

    def total(self) -> NDArray[np.float64]:
        """Sum over conditions, ``(7 + K^2,)``."""
        return self.terms.sum(axis=0)

    def grouped(self, groups: ArrayLike) -> ConditionSums:
        """Sums per group (episode cluster): one row per distinct value of ``groups`` ``(n_conditions,)``."""
        labels = np.asarray(groups)
        if labels.shape != (len(self.terms),):
            raise ValueError(f"groups have shape {labels.shape}, expected ({len(self.terms)},): one per condition")
        _, index = np.unique(labels, return_inverse=True)
        terms = np.zeros((index.max() + 1, self.terms.shape[1]))
        np.add.at(terms, index, self.terms)
        return ConditionSums(terms, self.n_modes)


def condition_sums(table: ArrayLike) -> ConditionSums:
    """Additive terms of counts ``(n_conditions, K+1, K+1)``, the last row and column holding invalid samples.

    Raises:
        ValueError: If the table is not of that shape, has no condition or fewer than two modes.
    """
    counts = validate_counts(table, smallest=3)
    if counts.ndim != 3 or len(counts) == 0:
        raise ValueError(f"table has shape {counts.shape}, expected (n_conditions, K+1, K+1) with a condition or more")
    effect = coordination(both_valid(counts))
    n = np.asarray(effect.n, dtype=np.float64)
    means = np.stack([effect.obs, effect.bl, effect.delta, effect.capacity, effect.capacity_tight], axis=1)
    weighted = np.where(n[:, None] > 0, n[:, None] * means, 0.0)
    sampled = counts.sum(axis=(-2, -1), dtype=np.float64)
    cells = both_valid(counts).reshape(len(counts), -1).astype(np.float64)
    return ConditionSums(np.column_stack([sampled, n, weighted, cells]), effect.n_modes)


def run_statistics(sums: NDArray[np.float64], n_modes: int) -> dict[str, NDArray[np.float64]]:
    """The run's values from (weighted) sums ``(..., 7 + K^2)`` of condition terms.

    Returns:
        valid_rate, obs, bl, delta, capacity, capacity_tight, rho, delta_pooled, capacity_pooled, rho_pooled
        and simpson, each with the leading shape; NaN where undefined.
    """
    sampled, both = sums[..., 0], sums[..., 1]

    def over(numerator: NDArray, denominator: NDArray) -> NDArray:
        return np.divide(numerator, denominator, out=np.full(np.shape(numerator), np.nan), where=denominator > 0)

    values = {name: over(sums[..., 2 + i], both) for i, name in enumerate(TERMS[2:])}
    cells = sums[..., len(TERMS) :].reshape(*sums.shape[:-1], n_modes, n_modes)
    rows, columns = cells.sum(axis=-1), cells.sum(axis=-2)
    squared = both**2
    effect = both * np.trace(cells, axis1=-2, axis2=-1) - (rows * columns).sum(axis=-1)
    spread_q, spread_p = squared - (rows**2).sum(axis=-1), squared - (columns**2).sum(axis=-1)
    bound = np.sqrt(spread_q * spread_p)
    delta_pooled = over(effect, squared)
    return {
        "valid_rate": over(both, sampled),
        **values,
        "rho": over(sums[..., 4], sums[..., 5]),
        "delta_pooled": delta_pooled,
        "capacity_pooled": over(bound, squared),
        "rho_pooled": over(effect, bound),
        "simpson": delta_pooled - values["delta"],
    }
