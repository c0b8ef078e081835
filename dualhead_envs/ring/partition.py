"""The ring's mode partition: which mode a path belongs to, if any."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualhead_envs.ring import geometry


class RingPartition:
    """Labels paths by their largest peak projection on a mode direction, relative to the radius.

    ``peak_k = max_h <x[h], u_k> / r``; the label is ``argmax_k peak_k``, and -1 (invalid) where that peak is
    below ``tau`` (paper, appendix "Testbed and environment specification").

    Args:
        n_modes: Number of modes K.
        angles: Offsets of the modes from theta in radians, equally spaced by default.
        tau: Default threshold, as a share of the radius.
    """

    name = "ring"

    def __init__(self, n_modes: int, angles: Sequence[float] | None = None, tau: float = geometry.TAU):
        self.angles = geometry.mode_angles(n_modes, angles)
        self.n_modes = len(self.angles)
        self.tau = _threshold(tau)

    def score(self, path: ArrayLike, condition: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Labels before thresholding and their strengths: ``assign`` keeps a label where strength >= tau.

        Args:
            path: Points (..., H, 2) in metres.
            condition: ``(cos theta, sin theta, r)`` (..., 3); leading axes broadcast with those of ``path``.

        Returns:
            ``label`` (...) int64 in 0..K-1 and ``strength`` (...) float64, the largest peak over the radius.

        Raises:
            ValueError: If shapes do not fit, or a path or condition holds a number that is not finite.
        """
        points = np.asarray(path, dtype=np.float64)
        if points.ndim < 2 or points.shape[-1] != 2 or points.shape[-2] == 0:
            raise ValueError(f"path has shape {points.shape}, expected (..., H, 2): pass positions, one row a step")
        if not np.isfinite(points).all():
            raise ValueError("path holds NaN or infinite positions: drop or repair these samples before labelling")
        directions = geometry.mode_directions(condition, self.angles)
        x, y = points[..., 0], points[..., 1]
        peaks = np.stack(
            [
                (x * directions[..., k, 0, None] + y * directions[..., k, 1, None]).max(axis=-1)
                for k in range(self.n_modes)
            ],
            axis=-1,
        )
        label = peaks.argmax(axis=-1)
        return label, peaks.max(axis=-1) / np.asarray(condition, dtype=np.float64)[..., 2]

    def assign(self, path: ArrayLike, condition: ArrayLike, tau: float | None = None) -> np.ndarray:
        """Labels (...) int64 of ``path`` (..., H, 2) under ``condition`` (..., 3): 0..K-1, or -1 if invalid.

        Args:
            path: Points in metres.
            condition: ``(cos theta, sin theta, r)``, broadcast over leading axes.
            tau: Threshold, the partition's own by default.

        Raises:
            ValueError: As :meth:`score`, or if ``tau`` is not positive.
        """
        label, strength = self.score(path, condition)
        return np.where(strength >= (self.tau if tau is None else _threshold(tau)), label, -1)

    def to_dict(self) -> dict[str, Any]:
        """JSON description for gate files and datasets."""
        return {
            "name": self.name,
            "n_modes": self.n_modes,
            "tau": self.tau,
            "parameters": {"mode_angles": list(self.angles)},
        }


def _threshold(tau: float) -> float:
    if not (np.isfinite(tau) and tau > 0):
        raise ValueError(f"tau={tau!r} should be a positive share of the ring's radius, for example 0.55")
    return float(tau)
