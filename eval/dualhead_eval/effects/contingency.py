"""The coordination effect of a contingency table, exact until the last division.

Two heads label the same samples with one of K modes. Of the pairs in which both labels are valid, counts
``(..., K, K)`` say how often head A chose row k while head B chose column l. Everything here is a function of
such counts alone, for any K and any leading axes (conditions, runs, thresholds).

Numerators are integers. With n pairs, row sums r, column sums s and trace d (paper: sec:calculus),

    n^2 Delta   = n d - sum r_k s_k              n^2 G(q) = n^2 - sum r_k^2
    n^2 C_tight = n sum min(r_k, s_k) - sum r_k s_k

so perfect agreement with equal marginals gives ``delta == capacity`` and ``rho == 1.0`` exactly, and the
bounds ``|delta| <= capacity`` and ``delta <= capacity_tight <= capacity`` hold in floating point without a
tolerance up to 9e7 pairs a table (every numerator is then a float, and rounding is monotone).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Why ``rho`` is NaN, indexed by :attr:`Coordination.undefined`.
UNDEFINED_REASONS = (
    "",
    "head A chose a single mode: capacity is zero, delta is zero and rho is undefined",
    "head B chose a single mode: capacity is zero, delta is zero and rho is undefined",
    "both heads chose a single mode each: capacity is zero, delta is zero and rho is undefined",
    "no pair in which both heads are valid: only the valid-pair rate is defined",
)

#: Largest number of pairs for which n^2 fits in an int64; beyond it Python's own integers take over.
_INT64_PAIRS = isqrt(np.iinfo(np.int64).max)


@dataclass(frozen=True)
class Coordination:
    """Same-label coordination of two heads; every field has the counts' leading shape ``(...)``.

    Attributes:
        n: Both-valid pairs (integer).
        obs: Observed mismatch, 1 - p_o.
        bl: Mismatch expected if each head chose alone from its own marginal, 1 - sum q_k p_k.
        delta: Coordination effect bl - obs, positive when the heads agree more than chance (paper: Delta).
        capacity: Largest possible delta given each head's diversity, sqrt(G(q) G(p)) (thm:region, ii).
        capacity_tight: Largest possible delta at these marginals, bl - TV(q, p) (thm:region, iv).
        rho: delta / capacity, Gorodkin's R_K; NaN where the capacity is zero, never 0 or 1.
        kappa: Cohen's kappa, delta / bl; NaN where bl is zero.
        q: Head A's mode frequencies among both-valid pairs, ``(..., K)``.
        p: Head B's mode frequencies among both-valid pairs, ``(..., K)``.
        diversity_q: Gini-Simpson diversity G(q) = 1 - sum q_k^2.
        diversity_p: Gini-Simpson diversity G(p).
        undefined: 0 where rho is defined, otherwise an index into :data:`UNDEFINED_REASONS`.
    """

    n: NDArray
    obs: NDArray
    bl: NDArray
    delta: NDArray
    capacity: NDArray
    capacity_tight: NDArray
    rho: NDArray
    kappa: NDArray
    q: NDArray
    p: NDArray
    diversity_q: NDArray
    diversity_p: NDArray
    undefined: NDArray

    @property
    def n_modes(self) -> int:
        """Number of modes K."""
        return int(self.q.shape[-1])

    @property
    def reason(self) -> NDArray:
        """Why rho is NaN, in words; the empty string where it is defined."""
        return np.array(UNDEFINED_REASONS, dtype=object)[self.undefined]

    @property
    def tv(self) -> NDArray:
        """Total variation between the two heads' marginals, half of sum |q_k - p_k| (the bias index)."""
        return 0.5 * np.abs(self.q - self.p).sum(axis=-1)

    @property
    def capacity_relative(self) -> NDArray:
        """Capacity over its largest value at this K, capacity / (1 - 1/K): comparable across K."""
        return self.capacity / (1 - 1 / self.n_modes)


def validate_counts(counts: ArrayLike, *, smallest: int = 2) -> NDArray:
    """Counts as an integer array ``(..., K, K)``, or a sentence about what is wrong with them.

    Integer-valued floats are accepted up to 2^53, above which they no longer tell neighbouring integers
    apart.

    Raises:
        ValueError: If the last two axes are not square with at least ``smallest`` modes, or if a count is
            negative, NaN, infinite or not an integer.
    """
    array = np.asarray(counts)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        raise ValueError(
            f"counts have shape {array.shape}, expected (..., K, K): count the both-valid pairs per (head A "
            f"mode, "
            "head B mode), for example with dualhead_eval.effects.counts.joint_counts"
        )
    if array.shape[-1] < smallest:
        raise ValueError(
            f"counts have K={array.shape[-1]} modes, expected at least {smallest}: with one mode there is "
            f"nothing "
            "to coordinate"
        )
    if array.dtype.kind == "f":
        if not np.isfinite(array).all():
            raise ValueError("counts contain NaN or infinity, expected integers: drop or fix these tables first")
        if (array != np.floor(array)).any() or (np.abs(array) > 2**53).any():
            raise ValueError("counts are not integers: pass counts of pairs, not frequencies or weights")
        array = array.astype(np.int64)
    elif array.dtype.kind == "O":
        if not all(isinstance(value, int | np.integer) for value in array.flat):
            raise ValueError("counts are not integers: pass counts of pairs, not frequencies or weights")
    elif array.dtype.kind not in "iub":
        raise ValueError(f"counts have dtype {array.dtype}, expected integers: pass counts of pairs")
    if array.size and array.min() < 0:
        raise ValueError(f"counts contain {array.min()}, expected numbers >= 0: counts of pairs are never negative")
    return array


def coordination(counts: ArrayLike) -> Coordination:
    """Coordination effect, capacity and their ratio from both-valid counts ``(..., K, K)``.

    Rows are head A's modes, columns head B's. Tables without a pair have NaN everywhere but ``n``; tables in
    which a head chose a single mode have delta 0, capacity 0 and rho NaN, with the reason in ``reason``.

    >>> effect = coordination([[40, 10], [10, 40]])
    >>> float(effect.delta), float(effect.capacity), float(effect.rho)
    (0.3, 0.5, 0.6)

    Raises:
        ValueError: See :func:`validate_counts`.
    """
    array = validate_counts(counts)
    leading, n_modes = array.shape[:-2], array.shape[-1]
    # Table axes first: a million small tables become K^2 long vectors.
    tables = np.ascontiguousarray(array.reshape(-1, n_modes * n_modes).T)
    tables = tables.reshape(n_modes, n_modes, -1)
    largest = int(tables.max(initial=0)) * n_modes * n_modes
    tables = tables.astype(np.int64 if largest <= _INT64_PAIRS else object)

    rows = [sum(tables[k, m] for m in range(n_modes)) for k in range(n_modes)]
    columns = [sum(tables[k, m] for k in range(n_modes)) for m in range(n_modes)]
    n = sum(rows)
    squared = n * n
    agreeing = n * sum(tables[k, k] for k in range(n_modes))
    expected = sum(r * s for r, s in zip(rows, columns, strict=True))
    attainable = n * sum(np.minimum(r, s) for r, s in zip(rows, columns, strict=True))
    spread_q = squared - sum(r * r for r in rows)
    spread_p = squared - sum(s * s for s in columns)

    no_pair = np.asarray(n == 0, dtype=bool)
    # An empty table has both spreads zero: 1 + 2 + 1 = 4, the index of its own reason.
    undefined = sum(
        np.asarray(case, dtype=np.int8) * weight
        for case, weight in ((spread_q == 0, np.int8(1)), (spread_p == 0, np.int8(2)), (no_pair, np.int8(1)))
    )

    def real(integers: NDArray) -> NDArray:
        return np.asarray(integers, dtype=np.float64)

    total = np.where(no_pair, np.nan, real(squared))
    pairs = np.where(no_pair, np.nan, real(n))
    # sqrt(x * x) is exactly x, which a product of two roots would not give.
    bound = np.sqrt(real(spread_q) * real(spread_p))
    mismatch = real(squared - expected)
    effect = real(agreeing - expected)

    def shaped(values: NDArray) -> NDArray:
        return values.reshape(leading)[()]

    return Coordination(
        n=shaped(np.asarray(n)),
        obs=shaped(real(squared - agreeing) / total),
        bl=shaped(mismatch / total),
        delta=shaped(effect / total),
        capacity=shaped(bound / total),
        capacity_tight=shaped(real(attainable - expected) / total),
        rho=shaped(_ratio(effect, bound)),
        kappa=shaped(_ratio(effect, mismatch)),
        q=np.stack([real(r) / pairs for r in rows], axis=-1).reshape(*leading, n_modes),
        p=np.stack([real(s) / pairs for s in columns], axis=-1).reshape(*leading, n_modes),
        diversity_q=shaped(real(spread_q) / total),
        diversity_p=shaped(real(spread_p) / total),
        undefined=shaped(np.asarray(undefined)),
    )


def _ratio(numerator: NDArray, denominator: NDArray) -> NDArray:
    """numerator / denominator, NaN where the denominator is zero."""
    return np.divide(numerator, denominator, out=np.full(np.shape(denominator), np.nan), where=denominator != 0)
