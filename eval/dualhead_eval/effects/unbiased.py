"""Coordination of one condition without plug-in bias, from as few as two pairs.

The plug-in effect compares matched pairs with all pairs, each matched pair included, and so shrinks towards
zero: with n pairs its mean is (n - 1)/n of the truth. Comparing matched pairs (i, i) with mismatched pairs
(i, j), i != j, removes the bias; the same for each head's diversity with distinct draws. Both equal n/(n - 1)
times the plug-in value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.contingency import validate_counts


@dataclass(frozen=True)
class UnbiasedCoordination:
    """Unbiased per-table estimates; NaN where a table holds fewer than two both-valid pairs.

    Attributes:
        n: Both-valid pairs ``(...)``.
        delta: Agreement of matched pairs minus mean agreement of mismatched pairs, in [-1, 1].
        diversity_q: One minus the mean agreement of head A's distinct draws, in [0, 1].
        diversity_p: The same for head B.
    """

    n: NDArray
    delta: NDArray
    diversity_q: NDArray
    diversity_p: NDArray

    @property
    def capacity(self) -> float:
        """sqrt(mean G_q * mean G_p) over tables; a square root per table would be badly biased at small n.

        By Cauchy-Schwarz it is at least the mean of the tables' own capacities, so rho errs towards zero.
        """
        usable = self.n >= 2
        if not usable.any():
            return float("nan")
        return float(np.sqrt(self.diversity_q[usable].mean() * self.diversity_p[usable].mean()))


def unbiased_coordination(counts: ArrayLike) -> UnbiasedCoordination:
    """Unbiased effect and diversities of both-valid counts ``(..., K, K)``.

    Raises:
        ValueError: If the counts are not non-negative integers of that shape.
    """
    tables = validate_counts(counts).astype(np.int64)
    rows, columns = tables.sum(axis=-1), tables.sum(axis=-2)
    n = rows.sum(axis=-1)
    distinct = n * (n - 1)

    def over(numerator: NDArray) -> NDArray:
        return np.divide(numerator, distinct, out=np.full(n.shape, np.nan), where=distinct > 0)

    agreeing = np.trace(tables, axis1=-2, axis2=-1)
    return UnbiasedCoordination(
        n=n,
        delta=over(n * agreeing - (rows * columns).sum(axis=-1)),
        diversity_q=over(distinct - (rows * (rows - 1)).sum(axis=-1)),
        diversity_p=over(distinct - (columns * (columns - 1)).sum(axis=-1)),
    )
