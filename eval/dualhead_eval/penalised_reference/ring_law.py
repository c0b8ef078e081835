"""The joint law of both heads' chunks on a two-mode ring: exact in each coordinate of time, or moment-matched."""

from __future__ import annotations

import numpy as np

from dualhead_envs.ring import geometry
from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.maps import RepresentationMap
from dualhead_eval.penalised_reference.two_mode_pair import TwoModePair

#: Paths from which the moments of a nonlinear representation are estimated.
MOMENT_PATHS = 16_384


def linear_law(matrix: np.ndarray, half: np.ndarray, variance: float, beta: float, log_odds: float) -> TwoModePair:
    """One coordinate of time under a linear map.

    Args:
        matrix: From positions to head A's space (d, 2), with orthonormal columns.
        half: Half of the difference between the modes' means in the plane (2,).
        variance: Of both plane coordinates within a mode.
        beta: Coupling of the heads' source noise.
        log_odds: log P(mode 1) / P(mode 0).
    """
    return TwoModePair(
        half_a=matrix @ half,
        half_b=half,
        kinematics=matrix.T,
        covariance_a=variance * matrix @ matrix.T,
        covariance_b=variance * np.eye(2),
        covariance_ab=variance * matrix,
        noise_ab=(1 - beta) * np.eye(len(matrix), 2),
        log_odds=log_odds,
        loss_ratio=2 / len(matrix),
    )


def matched_law(
    representation: RepresentationMap, generator: RingGenerator, condition: np.ndarray, beta: float
) -> TwoModePair:
    """Whole chunks under a map that is not linear but turns with the plane, for two opposite modes.

    Both modes get the moments of mode 1, of which mode 0 is the reflection through the origin, and the map becomes the
    linear regression of the position on head A's point, step by step, over both modes.

    Args:
        representation: The map.
        generator: Of the paths.
        condition: (cos theta, sin theta, r).
        beta: Coupling of the heads' source noise.
    """
    rng = np.random.default_rng(0)
    path = generator.draw_paths(
        rng, np.broadcast_to(condition, (MOMENT_PATHS, 3)), np.ones(MOMENT_PATHS, dtype=np.int64)
    )
    points = representation.from_position(path)
    width, steps = points.shape[-1], geometry.HORIZON
    # Moments about the origin are those of both modes together, since one is the reflection of the other.
    outer = np.einsum("nhi,nhj->hij", points, points), np.einsum("nhi,nhj->hij", path, points)
    kinematics = np.zeros((steps, 2, steps, width))
    kinematics[np.arange(steps), :, np.arange(steps)] = outer[1] @ np.linalg.inv(outer[0])
    flat_a, flat_b = points.reshape(MOMENT_PATHS, -1), path.reshape(MOMENT_PATHS, -1)
    covariance = np.cov(np.concatenate([flat_a, flat_b], axis=1), rowvar=False)
    n = flat_a.shape[1]
    log_odds = float(np.log(generator.probabilities[1] / generator.probabilities[0]))
    return TwoModePair(
        half_a=flat_a.mean(axis=0),
        half_b=flat_b.mean(axis=0),
        kinematics=kinematics.reshape(2 * steps, width * steps),
        covariance_a=covariance[:n, :n],
        covariance_b=covariance[n:, n:],
        covariance_ab=covariance[:n, n:],
        noise_ab=(1 - beta) * np.kron(np.eye(steps), np.eye(width, 2)),
        log_odds=log_odds,
        loss_ratio=2 / width,
    )
