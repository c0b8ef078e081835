"""The head-valid approximation of the paper's older runs, for comparison only (sec:gate, tab:caliber).

It takes each head's mode frequencies from all samples in which that head is valid, while the mismatch is that
of both-valid pairs. The two populations differ, so its points can leave the attainable region: such
excursions are artefacts of the accounting, and are counted here on integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.contingency import validate_counts
from dualhead_eval.effects.counts import both_valid


@dataclass(frozen=True)
class HeadValidCoordination:
    """Head-valid quantities per table ``(...)``, NaN where a head is never valid or no pair is both-valid.

    Attributes:
        n: Both-valid pairs.
        delta: Head-valid chance mismatch minus both-valid mismatch.
        capacity: sqrt(G(q) G(p)) at head-valid marginals.
        capacity_tight: Fixed-marginal bound at head-valid marginals.
        above_capacity: Whether delta exceeds capacity, decided on integers.
        above_tight: Whether delta exceeds capacity_tight, decided on integers.
    """

    n: NDArray
    delta: NDArray
    capacity: NDArray
    capacity_tight: NDArray
    above_capacity: NDArray
    above_tight: NDArray

    def run(self) -> dict[str, float]:
        """Run values in the protocol's order: weighted means, rho their ratio, excursions counted."""
        kept = np.isfinite(self.delta)
        weight = np.where(kept, self.n, 0).astype(np.float64)
        if weight.sum() == 0:
            means = dict.fromkeys(("delta", "capacity", "capacity_tight"), float("nan"))
        else:
            means = {
                name: float(np.average(getattr(self, name)[kept], weights=weight[kept]))
                for name in ("delta", "capacity", "capacity_tight")
            }
        rho = means["delta"] / means["capacity"] if means["capacity"] > 0 else float("nan")
        return {
            **means,
            "rho": rho,
            "above_capacity": float(self.above_capacity.sum()),
            "above_tight": float(self.above_tight.sum()),
        }


def head_valid_coordination(table: ArrayLike) -> HeadValidCoordination:
    """Head-valid approximation from counts ``(..., K+1, K+1)`` with invalid samples in the last row and
    column.

    Raises:
        ValueError: If the counts are not non-negative integers of that shape.
    """

    def exact(integers: ArrayLike) -> NDArray:
        return np.asarray(integers, dtype=object)

    # Python integers: the cross-multiplied comparisons are of sixth order in the counts.
    counts = exact(validate_counts(table, smallest=3))
    rows, columns = counts[..., :-1, :].sum(axis=-1), counts[..., :, :-1].sum(axis=-2)
    paired = both_valid(counts)
    n, agreeing = exact(paired.sum(axis=(-2, -1))), exact(np.trace(paired, axis1=-2, axis2=-1))
    a, b = exact(rows.sum(axis=-1)), exact(columns.sum(axis=-1))
    crossed = exact((rows * columns).sum(axis=-1))
    delta = n * (a * b - crossed) - (n - agreeing) * a * b
    spread = (a * a - (rows * rows).sum(axis=-1)) * (b * b - (columns * columns).sum(axis=-1))
    tight = np.minimum(rows * b[..., None], columns * a[..., None]).sum(axis=-1) - crossed
    above_capacity = np.asarray((delta > 0) & (delta * delta > n * n * spread), dtype=bool)
    above_tight = np.asarray(delta > n * tight, dtype=bool)

    def over(numerator: NDArray, denominator: NDArray) -> NDArray:
        x, y = np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)
        return np.divide(x, y, out=np.full(y.shape, np.nan), where=y > 0)[()]

    both_heads = a * b
    root = np.sqrt(np.asarray(spread, dtype=np.float64))
    defined = n > 0
    return HeadValidCoordination(
        n=n.astype(np.int64)[()],
        delta=over(delta, n * both_heads),
        capacity=over(np.where(defined, root, np.nan), both_heads),
        capacity_tight=over(np.where(defined, np.asarray(tight, dtype=np.float64), np.nan), both_heads),
        above_capacity=above_capacity[()],
        above_tight=above_tight[()],
    )
