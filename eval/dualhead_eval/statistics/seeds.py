"""Inference with the training seed as the unit: what a claim about a mechanism needs (sec:stats-honesty).

Intervals over conditions describe one checkpoint; a mechanism is described by its seeds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import false_discovery_control, t

from dualhead_eval.statistics.bootstrap import MARGIN, Equivalence
from dualhead_eval.statistics.interval import Interval


def _seeds(values: ArrayLike, smallest: int = 2) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or array.size < smallest or not np.isfinite(array).all():
        raise ValueError(
            f"seed values have shape {array.shape}, expected a list of at least {smallest} finite numbers: a "
            "seed whose rho is undefined must be named, not averaged"
        )
    return array


def seed_t_interval(values: ArrayLike, level: float = 0.95) -> Interval:
    """Student's t interval for the mean over seeds.

    Raises:
        ValueError: If fewer than two seeds are given, or one is not finite.
    """
    x = _seeds(values)
    half = t.ppf((1 + level) / 2, x.size - 1) * x.std(ddof=1) / np.sqrt(x.size)
    return Interval(float(x.mean() - half), float(x.mean() + half), level)


def seed_bootstrap_interval(
    values: ArrayLike, level: float = 0.95, *, draws: int = 2000, rng: np.random.Generator
) -> Interval:
    """Percentile interval for the mean over seeds; too short with few seeds, so read it beside the t
    interval.

    Raises:
        ValueError: If fewer than two seeds are given, or one is not finite.
    """
    x = _seeds(values)
    means = x[rng.integers(0, x.size, size=(draws, x.size))].mean(axis=1)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high), level)


def seed_equivalence(values: ArrayLike, *, margin: float = MARGIN) -> Equivalence:
    """TOST at 5% on the seed mean of rho, from the 90% t interval (tab:seeds).

    Raises:
        ValueError: If fewer than two seeds are given, or one is not finite.
    """
    interval = seed_t_interval(values, 0.90)
    width = interval.largest_magnitude
    return Equivalence(margin, interval, width, width < margin)


@dataclass(frozen=True)
class Interaction:
    """A permutation test of an arm-by-level interaction.

    Attributes:
        effects: Mean arm difference at each level (map), D(level).
        spread: Largest minus smallest effect.
        p_value: Share of permutations with a spread at least as large, the observed one included.
        permutations: Number of permutations drawn.
        smallest_p_value: Smallest p-value that these many levels and seeds allow, whatever the effects.
    """

    effects: tuple[float, ...]
    spread: float
    p_value: float
    permutations: int
    smallest_p_value: float


def interaction_test(
    differences: ArrayLike, *, permutations: int = 10_000, rng: np.random.Generator, blocked: bool = True
) -> Interaction:
    """Does the arm difference depend on the level (sec:toy-mapping)?

    Args:
        differences: ``(levels, seeds)``: arm B minus arm A of one seed at one level.
        permutations: Number of random relabellings.
        rng: Source of randomness.
        blocked: Relabel levels within each seed (seeds may differ in their mean); otherwise across all cells.

    Raises:
        ValueError: If fewer than two levels or two seeds are given, or a difference is not finite.
    """
    d = np.asarray(differences, dtype=np.float64)
    if d.ndim != 2 or min(d.shape) < 2 or not np.isfinite(d).all():
        raise ValueError(
            f"differences have shape {d.shape}, expected (levels, seeds) with two or more of each, all finite"
        )
    observed = float(np.ptp(d.mean(axis=1)))
    copies = np.broadcast_to(d.T, (permutations, *d.T.shape))
    if blocked:
        shuffled = rng.permuted(copies, axis=2)
    else:
        shuffled = rng.permuted(copies.reshape(permutations, -1), axis=1).reshape(copies.shape)
    spreads = np.ptp(shuffled.mean(axis=1), axis=1)
    # Sums in another order may differ in the last bit from the observed ones.
    as_large = int((spreads >= observed * (1 - 1e-12)).sum())
    smallest = max(smallest_p_value(*d.shape) if blocked else 0.0, 1 / (1 + permutations))
    p_value = (1 + as_large) / (1 + permutations)
    return Interaction(tuple(d.mean(axis=1).tolist()), observed, p_value, permutations, smallest)


def smallest_p_value(levels: int, seeds: int) -> float:
    """Smallest p-value of a blocked interaction test.

    The spread is the largest mean less the smallest. Of the relabellings of a seed's levels, one in L (L - 1) puts its
    largest value and its smallest into two levels named beforehand, so that even with the same order in every seed a
    share (L (L - 1))^(1 - S) of all relabellings has the observed spread.

    >>> smallest_p_value(levels=2, seeds=5), smallest_p_value(levels=2, seeds=6)
    (0.0625, 0.03125)
    """
    return float(levels * (levels - 1)) ** (1 - seeds)


def benjamini_hochberg(p_values: ArrayLike) -> NDArray[np.float64]:
    """P-values adjusted so that rejecting those below q controls the false-discovery rate at q.

    Raises:
        ValueError: If a p-value is outside [0, 1].
    """
    p = np.asarray(p_values, dtype=np.float64)
    if p.size == 0 or not ((p >= 0) & (p <= 1)).all():
        raise ValueError("p-values are empty or outside [0, 1], expected one probability a test")
    return false_discovery_control(p, method="bh")
