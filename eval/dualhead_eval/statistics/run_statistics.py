"""A run's statistics as functions of sums over conditions, so that resampling is a matrix product.

Every statistic of a run is a function of sums over conditions. :func:`condition_sums` computes the terms once
from each condition's own table; :meth:`ConditionSums.statistics` turns any weighted sum of them into the run's
values. A bootstrap replicate is then a vector of weights, and re-runs the whole order: per condition, weighted
means, ratio of the means.

Two estimators share the order. ``"plug-in"`` is the protocol's: each condition's effect and capacity from its
observed frequencies. With n pairs in a condition it shrinks the effect by (n - 1)/n, which is nothing at 1280
pairs and half of it at two, and its capacity, a square root of small counts, is lost first where a mode is rare;
``"unbiased"`` (:mod:`dualhead_eval.effects.unbiased`) serves such runs, with the smaller of sqrt(mean G(q) * mean G(p))
and sqrt(mean G(q) G(p)) for capacity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.contingency import coordination, validate_counts
from dualhead_eval.effects.counts import both_valid
from dualhead_eval.effects.unbiased import unbiased_coordination

#: Leading columns of :attr:`ConditionSums.terms`; the pooled table's K^2 cells follow.
TERMS = (
    "sampled",
    "both_valid",
    "weight",
    "obs",
    "bl",
    "delta",
    "capacity",
    "capacity_tight",
    "diversity_q",
    "diversity_p",
    "product",
)
#: Pairs per condition of the frozen protocol, from which on its own plug-in estimate is kept, rare modes or not.
PROTOCOL_PAIRS = 1280
ESTIMATORS = ("plug-in", "unbiased")


@dataclass(frozen=True)
class ConditionSums:
    """Additive terms of each condition.

    Attributes:
        terms: ``(n_conditions, 11 + K^2)``: sampled pairs, both-valid pairs N, the condition's weight w (N; 0
            where the estimator needs two pairs and N is below), then w times each mean of :data:`TERMS`, then
            the both-valid counts themselves.
        n_modes: Number of modes K.
        estimator: One of :data:`ESTIMATORS`.
    """

    terms: NDArray[np.float64]
    n_modes: int
    estimator: str = "plug-in"

    def total(self) -> NDArray[np.float64]:
        """Sum over conditions, ``(11 + K^2,)``."""
        return self.terms.sum(axis=0)

    def too_few_pairs(self, limit: float) -> bool:
        """Whether plug-in terms rest on too few pairs for their rho.

        The plug-in effect is short by 1/n, and where a mode is rare the plug-in capacity by more: sqrt(G(q) G(p))
        of a few draws is often zero. Both biases of rho depend on the both-valid pairs per condition times the
        relative capacity, and stay within 1% of rho while that product is 50 or more.
        """
        total = dict(zip(TERMS, self.total(), strict=False))
        pairs = total["both_valid"] / max(1, (self.terms[:, TERMS.index("both_valid")] > 0).sum())
        relative = total["capacity"] / max(1, total["weight"]) / (1 - 1 / self.n_modes)
        most = total["sampled"] >= PROTOCOL_PAIRS * len(self.terms)
        return bool(pairs < limit or (0 < pairs * relative < limit and not most))

    def grouped(self, groups: ArrayLike) -> ConditionSums:
        """Sums per group (episode cluster): one row per distinct value of ``groups`` ``(n_conditions,)``."""
        labels = np.asarray(groups)
        if labels.shape != (len(self.terms),):
            raise ValueError(f"groups have shape {labels.shape}, expected ({len(self.terms)},): one per condition")
        _, index = np.unique(labels, return_inverse=True)
        terms = np.zeros((index.max() + 1, self.terms.shape[1]))
        np.add.at(terms, index, self.terms)
        return ConditionSums(terms, self.n_modes, self.estimator)

    def statistics(self, sums: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """The run's values from (weighted) sums ``(..., 11 + K^2)`` of condition terms.

        Returns:
            valid_rate, obs, bl, delta, capacity, capacity_tight, rho, delta_pooled, capacity_pooled, rho_pooled
            and simpson, each with the leading shape; NaN where undefined (capacity_tight has no unbiased form).
        """
        column = {name: sums[..., index] for index, name in enumerate(TERMS)}
        values = {name: _over(column[name], column["weight"]) for name in TERMS[3:8]}
        rho = _over(column["delta"], column["capacity"])
        if self.estimator == "unbiased":
            q, p, both = (_over(column[name], column["weight"]) for name in ("diversity_q", "diversity_p", "product"))
            values["capacity"] = np.sqrt(np.minimum(q * p, both))
            values["capacity_tight"] = np.full_like(values["capacity"], np.nan)
            rho = _over(values["delta"], values["capacity"])
        pooled = _pooled(sums[..., len(TERMS) :].reshape(*sums.shape[:-1], self.n_modes, self.n_modes))
        return {
            "valid_rate": _over(column["both_valid"], column["sampled"]),
            **values,
            "rho": rho,
            **pooled,
            "simpson": pooled["delta_pooled"] - values["delta"],
        }


def condition_sums(table: ArrayLike, estimator: str = "plug-in") -> ConditionSums:
    """Additive terms of counts ``(n_conditions, K+1, K+1)``, the last row and column holding invalid samples.

    Raises:
        ValueError: If the table is not of that shape, has no condition or fewer than two modes, or if the
            estimator has another name.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator={estimator!r}, expected one of {ESTIMATORS}")
    counts = validate_counts(table, smallest=3)
    if counts.ndim != 3 or len(counts) == 0:
        raise ValueError(f"table has shape {counts.shape}, expected (n_conditions, K+1, K+1) with a condition or more")
    valid = both_valid(counts)
    effect = coordination(valid)
    n = np.asarray(effect.n, dtype=np.float64)
    if estimator == "plug-in":
        weight = n
        means = [effect.obs, effect.bl, effect.delta, effect.capacity, effect.capacity_tight]
        means += [effect.diversity_q, effect.diversity_p, effect.diversity_q * effect.diversity_p]
    else:
        weight = np.where(n >= 2, n, 0.0)
        exact = unbiased_coordination(valid)
        nothing = np.zeros(len(n))
        means = [effect.obs, effect.obs + exact.delta, exact.delta, nothing, nothing]
        means += [exact.diversity_q, exact.diversity_p, exact.product_at_most]
    weighted = np.where(weight[:, None] > 0, weight[:, None] * np.stack(means, axis=1), 0.0)
    sampled = counts.sum(axis=(-2, -1), dtype=np.float64)
    cells = valid.reshape(len(counts), -1).astype(np.float64)
    return ConditionSums(np.column_stack([sampled, n, weight, weighted, cells]), effect.n_modes, estimator)


def _over(numerator: NDArray, denominator: NDArray) -> NDArray:
    return np.divide(numerator, denominator, out=np.full(np.shape(numerator), np.nan), where=denominator > 0)


def _pooled(cells: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Effect, capacity and rho of pooled tables ``(..., K, K)``."""
    rows, columns = cells.sum(axis=-1), cells.sum(axis=-2)
    n = rows.sum(axis=-1)
    squared = n**2
    effect = n * np.trace(cells, axis1=-2, axis2=-1) - (rows * columns).sum(axis=-1)
    bound = np.sqrt((squared - (rows**2).sum(axis=-1)) * (squared - (columns**2).sum(axis=-1)))
    return {
        "delta_pooled": _over(effect, squared),
        "capacity_pooled": _over(bound, squared),
        "rho_pooled": _over(effect, bound),
    }
