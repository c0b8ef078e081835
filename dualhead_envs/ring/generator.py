"""The scripted expert: Gaussian paths to the modes of a ring (paper, appendix "Testbed").

``x[h] = s_h (r u_k + delta) + 0.02 eta[h]`` for h = 0..15, with ``s_h = sin(pi h / 15)``,
``delta ~ N(0, path_spread^2 I)`` common to the path and ``eta ~ N(0, I)`` drawn at every point. Given the
condition and the mode, a path is thus Gaussian with mean ``s_h r u_k`` and covariance
``(path_spread^2 s s^T + 0.02^2 I) x I_2``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dualhead_envs.ring import geometry


def envelope() -> np.ndarray:
    """The amplitude ``s_h = sin(pi h / 15)`` of a path at each of its 16 points."""
    return np.sin(np.pi * np.arange(geometry.HORIZON) / (geometry.HORIZON - 1))


def mode_probabilities(n_modes: int, probabilities: Sequence[float] | None = None) -> tuple[float, ...]:
    """The prior over modes: ``probabilities`` if given (they must sum to 1), else uniform.

    Raises:
        ValueError: If ``probabilities`` are not K non-negative numbers that sum to 1.
    """
    if probabilities is None:
        return (1.0 / n_modes,) * n_modes
    values = np.asarray(probabilities, dtype=np.float64)
    if values.shape != (n_modes,) or not (values >= 0).all() or abs(values.sum() - 1.0) > 1e-6:
        raise ValueError(
            f"mode_probabilities={probabilities!r} should be {n_modes} non-negative numbers that sum to 1, one per mode"
        )
    return tuple((values / values.sum()).tolist())


class RingGenerator:
    """Draws conditions, modes and paths; float64 inside, vectorised over any leading axes.

    Args:
        n_modes: Number of modes K, at least 2.
        probabilities: Prior over modes, uniform by default.
        angles: Offsets of the modes from theta in radians, equally spaced by default.
        path_spread: Standard deviation of delta in metres; a larger one blurs the modes into each other.
    """

    def __init__(
        self,
        n_modes: int,
        probabilities: Sequence[float] | None = None,
        angles: Sequence[float] | None = None,
        path_spread: float = geometry.PATH_SPREAD,
    ):
        self.angles = geometry.mode_angles(n_modes, angles)
        self.n_modes = len(self.angles)
        self.probabilities = mode_probabilities(self.n_modes, probabilities)
        if not (np.isfinite(path_spread) and path_spread >= 0):
            raise ValueError(f"path_spread={path_spread!r} should be a non-negative length in metres")
        self.path_spread = float(path_spread)

    def draw_conditions(self, rng: np.random.Generator, shape: int | tuple[int, ...] = ()) -> np.ndarray:
        """Conditions (*shape, 3): theta uniform on the circle, r uniform in ``RADIUS_RANGE``."""
        theta = rng.uniform(0.0, 2 * np.pi, shape)
        return geometry.condition_vector(theta, rng.uniform(*geometry.RADIUS_RANGE, shape))

    def draw_modes(self, rng: np.random.Generator, shape: int | tuple[int, ...] = ()) -> np.ndarray:
        """Modes (*shape), int64, from the prior."""
        return np.asarray(rng.choice(self.n_modes, size=shape, p=self.probabilities), dtype=np.int64)

    def draw_paths(self, rng: np.random.Generator, condition: ArrayLike, mode: ArrayLike) -> np.ndarray:
        """Paths (..., 16, 2) in metres towards ``mode`` (...) under ``condition`` (..., 3).

        Raises:
            ValueError: If a mode is not in 0..K-1 or the condition is not one.
        """
        mode = np.asarray(mode)
        if not (np.issubdtype(mode.dtype, np.integer) and ((mode >= 0) & (mode < self.n_modes)).all()):
            raise ValueError(f"mode={mode.tolist()!r} should be integers from 0 to {self.n_modes - 1}")
        means = self.mean_paths(condition)
        shape = np.broadcast_shapes(means.shape[:-3], mode.shape)
        means = np.broadcast_to(means, (*shape, *means.shape[-3:]))
        index = np.broadcast_to(mode, shape)[..., None, None, None]
        mean = np.take_along_axis(means, index, axis=-3)[..., 0, :, :]
        delta = self.path_spread * rng.standard_normal((*shape, 1, 2))
        eta = rng.standard_normal((*shape, geometry.HORIZON, 2))
        return mean + envelope()[:, None] * delta + geometry.POINT_NOISE * eta

    def mean_paths(self, condition: ArrayLike) -> np.ndarray:
        """Each mode's mean path ``s_h r u_k`` (..., K, 16, 2) in metres under ``condition`` (..., 3)."""
        targets = geometry.mode_directions(condition, self.angles)
        targets = targets * np.asarray(condition, dtype=np.float64)[..., 2, None, None]
        return envelope()[:, None] * targets[..., None, :]

    def path_covariance(self) -> np.ndarray:
        """Covariance (16, 16) over the points of one coordinate of a path, in square metres."""
        s = envelope()
        return self.path_spread**2 * np.outer(s, s) + geometry.POINT_NOISE**2 * np.eye(len(s))
