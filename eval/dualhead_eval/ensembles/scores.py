"""Disagreement scores of an ensemble, and how much of them is members choosing different valid modes.

Action-L2 compares the members' samples; VFD (Romer et al., 2026, Eq. 7) compares their velocity fields at one
member's states, with shared initial noise and the time weight s / (1 - s). Either score is split by the
members' mode labels like any residual (sec:crn, sec:vfd): its cross-mode share is contamination.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.residuals.strata import ResidualStrata, residual_strata

#: A velocity field: states ``(N, ...)`` and a time in [0, 1) to velocities ``(N, ...)``.
VelocityField = Callable[[NDArray[np.float64], float], NDArray[np.float64]]


def action_l2(samples: ArrayLike) -> NDArray[np.float64]:
    """Pairwise distances between members' samples.

    Args:
        samples: ``(M, ..., H, d)``: sample i of every member, drawn with private or shared initial noise.

    Returns:
        ``(M, M, ...)``: mean over the window of the distance between members, in the samples' unit.

    Raises:
        ValueError: If there are fewer than two members.
    """
    x = np.asarray(samples, dtype=np.float64)
    if x.ndim < 3 or len(x) < 2:
        raise ValueError(f"samples have shape {x.shape}, expected (members, ..., H, d) with two members or more")
    # One pair at a time: all at once would need M^2 copies of the samples.
    distances = np.zeros((len(x), *x.shape[:-2]))
    for i, j in combinations(range(len(x)), 2):
        distances[i, j] = distances[j, i] = np.linalg.norm(x[i] - x[j], axis=-1).mean(axis=-1)
    return distances


def time_weight(s: float) -> float:
    """VFD's weight s / (1 - s) of the velocity difference at time s."""
    return s / (1 - s)


def vfd_score(
    fields: Sequence[VelocityField], source: ArrayLike, *, num_steps: int = 20, weighted: bool = True
) -> NDArray[np.float64]:
    """VFD's contribution of every ordered pair of members, per sample.

    All members start at the same ``source`` and walk their own Euler path; at each step of member i's path,
    member j is evaluated at member i's state.

    Args:
        fields: The members' velocity fields.
        source: Shared initial noise, ``(N, ...)``.
        num_steps: Euler steps; times are l / num_steps, l = 0 .. num_steps - 1.
        weighted: Multiply by s / (1 - s) (the published score), or not.

    Returns:
        ``(M, M, N)``: mean over steps of the weighted squared difference; the score of a sample is the mean
        over ordered pairs i != j.

    Raises:
        ValueError: If there are fewer than two members or no step.
    """
    return mean_over_steps(velocity_gaps(fields, source, num_steps=num_steps), weighted=weighted)


def velocity_gaps(fields: Sequence[VelocityField], source: ArrayLike, *, num_steps: int) -> NDArray[np.float64]:
    """Squared differences between members' velocities along every member's Euler path, the material of VFD.

    Args:
        fields: The members' velocity fields.
        source: Shared initial noise, ``(N, ...)``.
        num_steps: Euler steps; times are l / num_steps, l = 0 .. num_steps - 1.

    Returns:
        ``(M, M, N, num_steps)``: member j against member i at member i's state.

    Raises:
        ValueError: If there are fewer than two members or no step.
    """
    if len(fields) < 2 or num_steps < 1:
        raise ValueError(
            f"{len(fields)} members and {num_steps} steps given, expected two members and one step or more"
        )
    start = np.asarray(source, dtype=np.float64)
    gaps = np.zeros((len(fields), len(fields), len(start), num_steps))
    for i in range(len(fields)):
        x = start.copy()
        for step in range(num_steps):
            velocities = [field(x, step / num_steps) for field in fields]
            for j, velocity in enumerate(velocities):
                gap = (velocity - velocities[i]).reshape(len(start), -1)
                gaps[i, j, :, step] = (gap**2).sum(axis=1)
            x = x + velocities[i] / num_steps
    return gaps


def mean_over_steps(gaps: NDArray[np.float64], *, weighted: bool) -> NDArray[np.float64]:
    """VFD from :func:`velocity_gaps` ``(..., num_steps)``, with its time weight or without."""
    num_steps = gaps.shape[-1]
    weights = [time_weight(step / num_steps) if weighted else 1.0 for step in range(num_steps)]
    return gaps @ np.array(weights) / num_steps


def contamination(scores: ArrayLike, labels: ArrayLike, *, unit: str = "mm") -> dict[tuple[int, int], ResidualStrata]:
    """Split pairwise scores by whether the two members chose the same mode.

    Args:
        scores: ``(M, M, ..., n)``, for example from :func:`action_l2`; both orders of a pair are kept.
        labels: Members' mode labels, ``(M, ..., n)``.
        unit: Unit of the score.

    Returns:
        Strata by ordered pair (i, j), i != j.

    Raises:
        ValueError: If shapes do not match.
    """
    s, m = np.asarray(scores, dtype=np.float64), np.asarray(labels)
    if s.shape != (len(m), *m.shape):
        raise ValueError(f"scores have shape {s.shape} and labels {m.shape}, expected (M, M, ..., n) and (M, ..., n)")
    members = range(len(m))
    return {(i, j): residual_strata(s[i, j], m[i], m[j], unit=unit) for i in members for j in members if i != j}
