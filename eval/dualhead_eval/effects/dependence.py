"""Dependence that the same-label effect cannot see, and how many modes a head really uses.

Delta is the diagonal of the dependence matrix. At three or more modes it can vanish while the heads depend on
each other (sec:calculus); mutual information cannot, and stands beside it for that reason alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.contingency import validate_counts


def entropy(frequencies: ArrayLike) -> NDArray[np.float64]:
    """Entropy in nats of frequencies on the last axis ``(..., K)``; NaN where they are NaN."""
    f = np.asarray(frequencies, dtype=np.float64)
    logs = np.log(f, out=np.zeros_like(f), where=f > 0)
    # Adding zero turns -0.0 into 0.0.
    return -(f * logs).sum(axis=-1) + 0.0


def mutual_information(counts: ArrayLike) -> NDArray[np.float64]:
    """Plug-in mutual information in nats of both-valid counts ``(..., K, K)``; NaN without a pair.

    Biased upwards by about (K - 1)^2 / 2n for independent heads.

    Raises:
        ValueError: If the counts are not non-negative integers of that shape.
    """
    tables = validate_counts(counts).astype(np.float64)
    n = tables.sum(axis=(-2, -1), keepdims=True)
    joint = np.divide(tables, n, out=np.full(tables.shape, np.nan), where=n > 0)
    rows, columns = joint.sum(axis=-1), joint.sum(axis=-2)
    information = entropy(rows) + entropy(columns) - entropy(joint.reshape(*joint.shape[:-2], -1))
    # Rounding can leave -1e-17 for independent heads; NaN stays NaN.
    return np.where(information < 0, 0.0, information)


def diversity_from_effect(delta: ArrayLike, n_modes: int) -> NDArray[np.float64]:
    """Gini-Simpson diversity that an effect certifies for either head, K/(K-1) delta^2 (thm:region, iii)."""
    return n_modes / (n_modes - 1) * np.asarray(delta, dtype=np.float64) ** 2


def frequency_range_from_effect(delta: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Range of one mode's frequency that an effect certifies at two modes.

    2 q (1 - q) >= 2 delta^2 leaves q within 1/2 +- sqrt(1/4 - delta^2).

    >>> low, high = frequency_range_from_effect(0.4710)
    >>> round(float(low), 3), round(float(high), 3)
    (0.332, 0.668)

    Raises:
        ValueError: If an effect is outside [-1/2, 1/2], impossible at two modes.
    """
    d = np.asarray(delta, dtype=np.float64)
    if not (np.abs(d) <= 0.5).all():
        raise ValueError(f"delta={d.tolist()} is outside [-0.5, 0.5], expected an effect that two modes can have")
    half = np.sqrt(0.25 - d**2)
    return 0.5 - half, 0.5 + half
