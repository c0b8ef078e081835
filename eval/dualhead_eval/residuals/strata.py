"""What the cross-head residual is made of: same-mode and cross-mode pairs, as sufficient statistics.

A residual (millimetres, or degrees for orientations) is measured on every both-valid pair of samples. Pairs
in which both heads chose one mode form the same-mode stratum, the others the cross-mode stratum. Per
condition and stratum the count, sum, sum of squares and median are kept, and the Mann-Whitney U between the
strata; the shares and AUROCs of sec:share and sec:tautology follow from these alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Order of the strata on the last axis.
STRATA = ("same", "cross")
#: Millimetres, degrees, or none (VFD compares normalised velocities).
UNITS = ("mm", "deg", "1")


@dataclass(frozen=True)
class ResidualStrata:
    """Sufficient statistics of one residual component, per leading index and stratum (same, cross).

    Attributes:
        n: Both-valid pairs, ``(..., 2)``.
        total: Sum of the residual, ``(..., 2)``, in its unit.
        squares: Sum of squares, ``(..., 2)``.
        median: Median within the stratum, ``(..., 2)``; NaN where the stratum is empty.
        u: Mann-Whitney U of cross over same, ``(...)``: pairs of pairs in which the cross-mode residual is
            the larger one, ties counting one half.
        unit: One of :data:`UNITS`.
    """

    n: NDArray
    total: NDArray
    squares: NDArray
    median: NDArray
    u: NDArray
    unit: str = "mm"

    def __post_init__(self) -> None:
        shape = self.n.shape
        if not shape or shape[-1] != 2 or any(x.shape != shape for x in (self.total, self.squares, self.median)):
            raise ValueError(
                f"strata have shapes {shape}, {self.total.shape}, {self.squares.shape}, {self.median.shape}, "
                f"expected "
                "(..., 2) for all: compute them with dualhead_eval.residuals.strata.residual_strata"
            )
        if self.u.shape != shape[:-1]:
            raise ValueError(f"strata's U has shape {self.u.shape}, expected {shape[:-1]}")
        if (self.n < 0).any() or (self.u < 0).any() or (self.u > self.n[..., 0] * self.n[..., 1]).any():
            raise ValueError("strata contain a negative count, or a U outside 0..n_same * n_cross: evaluate again")

    def at(self, index: tuple) -> ResidualStrata:
        """The strata at ``index`` of the leading axes."""
        return ResidualStrata(
            self.n[index],
            self.total[index],
            self.squares[index],
            self.median[index],
            self.u[index],
            self.unit,
        )


def residual_strata(
    residual: ArrayLike, labels_a: ArrayLike, labels_b: ArrayLike, *, unit: str = "mm"
) -> ResidualStrata:
    """Strata of a residual ``(..., n)`` by the two heads' labels ``(..., n)`` (-1 is invalid and left out).

    Raises:
        ValueError: If shapes differ or the residual of a both-valid pair is NaN or negative.
    """
    values, a, b = np.asarray(residual, dtype=np.float64), np.asarray(labels_a), np.asarray(labels_b)
    if values.ndim == 0 or values.shape != a.shape or values.shape != b.shape:
        raise ValueError(
            f"residual has shape {values.shape} and labels {a.shape}, {b.shape}, expected one shape (..., n)"
        )
    valid = (a >= 0) & (b >= 0)
    if not (values[valid] >= 0).all():
        raise ValueError("residual of a both-valid pair is NaN or negative, expected a distance: check the samples")
    leading = values.shape[:-1]
    members = np.stack([valid & (a == b), valid & (a != b)], axis=-2)
    kept = np.where(members, values[..., None, :], 0.0)
    n = members.sum(axis=-1)

    rows = int(np.prod(leading, dtype=np.int64))
    median = np.full((rows, 2), np.nan)
    u = np.zeros(rows)
    for row, (strata, x) in enumerate(zip(members.reshape(rows, 2, -1), values.reshape(rows, -1), strict=True)):
        same, cross = x[strata[0]], x[strata[1]]
        for column, part in enumerate((same, cross)):
            if part.size:
                median[row, column] = np.median(part)
        if same.size and cross.size:
            ordered = np.sort(same)
            below = np.searchsorted(ordered, cross, "left").sum()
            u[row] = 0.5 * (below + np.searchsorted(ordered, cross, "right").sum())
    return ResidualStrata(
        n=n.astype(np.int64),
        total=kept.sum(axis=-1),
        squares=(kept**2).sum(axis=-1),
        median=median.reshape(*leading, 2),
        u=u.reshape(leading),
        unit=unit,
    )


@dataclass(frozen=True)
class ResidualSummary:
    """A run's residual, from its per-condition strata.

    Attributes:
        mean: Mean over all both-valid pairs (the paper's E[D]).
        same: Mean over same-mode pairs, the floor that coordination cannot lower.
        cross: Mean over cross-mode pairs.
        cross_share: Part of the residual's sum that cross-mode pairs contribute.
        over_floor: mean / same.
        auroc: Within-condition AUROC of the residual as a detector of cross-mode pairs, conditions weighted
            by their number of (cross, same) comparisons.
        auroc_conditions: Number of conditions in which both strata occur.
        unit: Unit of the means.

    A quantity whose denominator is zero is NaN.
    """

    mean: float
    same: float
    cross: float
    cross_share: float
    over_floor: float
    auroc: float
    auroc_conditions: int
    unit: str


def summarise_strata(strata: ResidualStrata) -> ResidualSummary:
    """Shares, means and AUROC of a run from strata with leading shape ``(n_conditions,)`` or any other."""
    n = strata.n.reshape(-1, 2).sum(axis=0)
    total = strata.total.reshape(-1, 2).sum(axis=0)
    comparisons = float((strata.n[..., 0] * strata.n[..., 1]).sum())

    def over(numerator: float, denominator: float) -> float:
        return float(numerator / denominator) if denominator > 0 else float("nan")

    mean, same = over(total.sum(), n.sum()), over(total[0], n[0])
    return ResidualSummary(
        mean=mean,
        same=same,
        cross=over(total[1], n[1]),
        cross_share=over(total[1], total.sum()),
        over_floor=over(mean, same),
        auroc=over(strata.u.sum(), comparisons),
        auroc_conditions=int(((strata.n[..., 0] > 0) & (strata.n[..., 1] > 0)).sum()),
        unit=strata.unit,
    )
