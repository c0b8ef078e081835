"""What the parts of one gate must agree on: counts with thresholds, strata with counts, provenance with both.

A checksum tells an accident from the file that was written; these checks tell a possible evaluation from an
impossible one, whoever computed the checksum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.effects.counts import pair_counts
from dualhead_eval.residuals.strata import UNITS, ResidualStrata

AGAIN = "evaluate again"
#: Sums of squares are rounded at a relative 1e-16 per pair.
ROUNDING = 1e-9
#: Residual component between the first head and the orientation head.
ROTATION = "rotation"


def check_thresholds(counts: NDArray[np.int64], n_heads: int) -> None:
    """A pair that is valid at a threshold is valid, with the same modes, at every lower one.

    Args:
        counts: ``(n_nfe, n_tau, n_conditions, K+1, ..., K+1)``, thresholds increasing.
        n_heads: Number of heads.

    Raises:
        ValueError: If a higher threshold has more valid samples of some modes.
    """
    modes: tuple[Any, ...] = (slice(None, -1),) * n_heads
    valid = counts[(..., *modes)]
    if (np.diff(valid, axis=1) > 0).any():
        raise ValueError(
            f"gate counts hold more valid samples at a higher threshold than at a lower one, expected fewer: {AGAIN}"
        )


def check_provenance(
    provenance: Mapping[str, Any], n_modes: int, reference_tau: float, counts: NDArray[np.int64]
) -> None:
    """The partition and the number of samples that a gate's provenance names, where it names them.

    Raises:
        ValueError: If they are not those of the tables.
    """
    if not isinstance(provenance, Mapping):
        raise ValueError(f"gate provenance is a {type(provenance).__name__}, expected a JSON object: {AGAIN}")
    partition = provenance.get("partition", {})
    if not isinstance(partition, Mapping):
        raise ValueError(f"gate partition is a {type(partition).__name__}, expected a JSON object: {AGAIN}")
    for name, own in (("n_modes", n_modes), ("tau", reference_tau)):
        if partition.get(name, own) != own:
            raise ValueError(
                f"gate partition has {name}={ascii(partition[name])[:40]}, its tables {own}: expected one partition; "
                f"{AGAIN}"
            )
    sampled = counts.sum(axis=tuple(range(3, counts.ndim)))
    stated = provenance.get("pairs_per_condition")
    if stated is not None and (type(stated) is not int or (sampled != stated).any()):
        raise ValueError(
            f"gate says pairs_per_condition={ascii(stated)[:40]}, its tables hold {int(sampled.min())} to "
            f"{int(sampled.max())}: {AGAIN}"
        )


def check_strata(strata: Mapping[str, ResidualStrata], counts: NDArray[np.int64], heads: Sequence[str]) -> None:
    """Each component's strata hold the both-valid pairs of its two heads, with moments that numbers can have.

    Raises:
        ValueError: If they do not.
    """
    for name, component in strata.items():
        if component.u.shape != counts.shape[:3]:
            raise ValueError(
                f"gate strata {name!r} have leading shape {component.u.shape}, expected {counts.shape[:3]}: {AGAIN}"
            )
        first, second = compared_heads(name, heads)
        valid = pair_counts(counts, len(heads), first, second)[..., :-1, :-1]
        same = valid.diagonal(axis1=-2, axis2=-1).sum(axis=-1)
        expected = np.stack([same, valid.sum(axis=(-2, -1)) - same], axis=-1)
        if (component.n != expected).any():
            raise ValueError(
                f"gate strata {name!r} count other same-mode and cross-mode pairs than the tables of heads "
                f"{heads[first]!r} and {heads[second]!r}: {AGAIN}"
            )
        _check_moments(name, component)


def compared_heads(component: str, heads: Sequence[str]) -> tuple[int, int]:
    """Positions of the two heads whose residual a component is.

    >>> compared_heads("position/lateral", ["joint", "position", "rotation"])
    (0, 1)
    >>> compared_heads("rotation", ["joint", "position", "rotation"])
    (0, 2)
    >>> compared_heads("b / c", ["a", "b", "c"])
    (1, 2)
    """
    members = component.split(" / ")
    if len(members) == 2 and all(member in heads for member in members):
        return heads.index(members[0]), heads.index(members[1])
    if component == ROTATION and ROTATION in heads:
        return 0, heads.index(ROTATION)
    return 0, 1


def _check_moments(name: str, strata: ResidualStrata) -> None:
    n, total, squares, median = strata.n, strata.total, strata.squares, strata.median
    empty = n == 0
    possible = (
        np.isfinite(total).all()
        and np.isfinite(squares).all()
        and np.isfinite(strata.u).all()
        and (total >= 0).all()
        and (np.isnan(median) == empty).all()
        and (median[~empty] >= 0).all()
        and (total[empty] == 0).all()
        and (squares[empty] == 0).all()
        and (total**2 <= n * squares * (1 + ROUNDING)).all()
        and (squares <= total**2 * (1 + ROUNDING)).all()
        # At least half of the distances are no smaller than the median.
        and (median[~empty] * n[~empty] <= 2 * total[~empty] * (1 + ROUNDING)).all()
        and strata.unit in UNITS
    )
    if not possible:
        raise ValueError(f"gate strata {name!r} hold sums, squares or medians that no distances have: {AGAIN}")
