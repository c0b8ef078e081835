"""Coordination of one condition without plug-in bias, from as few as two pairs.

The plug-in effect compares matched pairs with all pairs, each matched pair included, and so shrinks towards
zero: with n pairs its mean is (n - 1)/n of the truth. Comparing matched pairs (i, i) with mismatched pairs
(i, j), i != j, removes the bias; the same for each head's diversity with distinct draws. Both equal n/(n - 1)
times the plug-in value.

Capacity is a square root of G(q) G(p), which has no unbiased estimate; the product itself has one from four
pairs, head A's draws (i, j) beside head B's draws (k, l), all four distinct. It tells one head that has
collapsed in every condition from two heads that are both diverse in half of them, which the two mean
diversities cannot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.contingency import validate_counts

#: Pairs a condition from which the product of the diversities can be estimated.
PRODUCT_PAIRS = 4
#: Pairs for which n (n - 1) (n - 2) (n - 3) fits in an int64; beyond, Python's own integers take over.
_INT64_PAIRS = 50_000


@dataclass(frozen=True)
class UnbiasedCoordination:
    """Unbiased per-table estimates; NaN where a table holds fewer than two both-valid pairs.

    Attributes:
        n: Both-valid pairs ``(...)``.
        delta: Agreement of matched pairs minus mean agreement of mismatched pairs, in [-1, 1].
        diversity_q: One minus the mean agreement of head A's distinct draws, in [0, 1].
        diversity_p: The same for head B.
        product: Estimate of diversity_q * diversity_p from disjoint draws, in [0, 1]; NaN below four pairs.
        n_modes: Number of modes K.
    """

    n: NDArray
    delta: NDArray
    diversity_q: NDArray
    diversity_p: NDArray
    product: NDArray
    n_modes: int

    @property
    def product_at_most(self) -> NDArray:
        """The product; below four pairs (1 - 1/K) (G(q) + G(p)) / 2, whose mean is never below it."""
        bound = 0.5 * (1 - 1 / self.n_modes) * (self.diversity_q + self.diversity_p)
        return np.where(np.isnan(self.product), bound, self.product)

    @property
    def capacity(self) -> float:
        """Smaller of sqrt(mean G_q G_p) and sqrt(mean G_q * mean G_p) over tables.

        Both are at least the mean of the tables' own capacities (Jensen, Cauchy-Schwarz), so rho errs towards
        zero; a square root per table would be badly biased at small n.
        """
        usable = self.n >= 2
        if not usable.any():
            return float("nan")
        separate = self.diversity_q[usable].mean() * self.diversity_p[usable].mean()
        return float(np.sqrt(min(separate, self.product_at_most[usable].mean())))


def unbiased_coordination(counts: ArrayLike) -> UnbiasedCoordination:
    """Unbiased effect and diversities of both-valid counts ``(..., K, K)``.

    Raises:
        ValueError: If the counts are not non-negative integers of that shape.
    """
    array = validate_counts(counts)
    # A leading axis even for one table, so that sums stay arrays whatever their type.
    tables = array.reshape(-1, *array.shape[-2:])
    largest = int(tables.max(initial=0)) * tables.shape[-1] ** 2
    tables = tables.astype(np.int64 if largest <= _INT64_PAIRS else object)
    rows, columns = tables.sum(axis=-1), tables.sum(axis=-2)
    n = rows.sum(axis=-1)
    distinct = n * (n - 1)

    def over(numerator: NDArray, denominator: NDArray) -> NDArray:
        top, bottom = np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)
        ratio = np.divide(top, bottom, out=np.full(bottom.shape, np.nan), where=bottom > 0)
        return ratio.reshape(array.shape[:-2])[()]

    agreeing = np.trace(tables, axis1=-2, axis2=-1)
    # Ordered pairs of distinct draws that differ: in head A, in head B, in both.
    same_a, same_b = (rows * rows).sum(axis=-1), (columns * columns).sum(axis=-1)
    differ_a, differ_b = n * n - same_a, n * n - same_b
    differ_both = n * n - same_a - same_b + (tables * tables).sum(axis=(-2, -1))
    # Draws shared by (i, j) and (k, l): one in four ways, or both in two ways.
    others = (n[..., None] - rows)[..., :, None] * (n[..., None] - columns)[..., None, :]
    disjoint = differ_a * differ_b - 4 * (tables * others).sum(axis=(-2, -1)) + 2 * differ_both
    return UnbiasedCoordination(
        n=n.astype(np.int64).reshape(array.shape[:-2])[()],
        delta=over(n * agreeing - (rows * columns).sum(axis=-1), distinct),
        diversity_q=over(distinct - (rows * (rows - 1)).sum(axis=-1), distinct),
        diversity_p=over(distinct - (columns * (columns - 1)).sum(axis=-1), distinct),
        product=over(disjoint, np.where(n >= PRODUCT_PAIRS, distinct * (n - 2) * (n - 3), 0)),
        n_modes=tables.shape[-1],
    )
