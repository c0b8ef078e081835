"""Where the modes of a ring lie: constants, the condition vector, mode directions.

A condition is the vector that a policy sees, ``(cos theta, sin theta, r)``: the ring's rotation and its
radius in metres. Mode k lies at ``r u_k`` with ``u_k = (cos, sin)(theta + angle_k)`` (paper, appendix
"Testbed and environment specification"; equal spacing is ``angle_k = 2 pi k / K``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

#: Steps in an episode and points in a path.
HORIZON = 16
#: Bounds of the ring's radius, in metres.
RADIUS_RANGE = (0.70, 1.30)
#: Standard deviation of a path's common offset delta, in metres.
PATH_SPREAD = 0.08
#: Standard deviation of the noise eta of every single point, in metres.
POINT_NOISE = 0.02
#: A path whose largest peak projection is below this share of the radius belongs to no mode.
TAU = 0.55


def mode_angles(n_modes: int, angles: Sequence[float] | None = None) -> tuple[float, ...]:
    """Offsets of the modes from theta, in radians: ``angles`` if given, else K equally spaced ones.

    Raises:
        ValueError: If there are fewer than two modes, or ``angles`` are not K distinct finite directions.
    """
    if isinstance(n_modes, bool) or not isinstance(n_modes, int | np.integer) or n_modes < 2:
        raise ValueError(f"n_modes={n_modes!r} is not a number of modes: pass an integer of at least 2")
    if angles is None:
        return tuple(2 * np.pi * k / n_modes for k in range(n_modes))
    values = np.asarray(angles, dtype=np.float64)
    if values.shape != (n_modes,) or not np.isfinite(values).all():
        raise ValueError(f"mode_angles={angles!r} should be {n_modes} finite angles in radians, one per mode")
    gaps = np.diff(np.sort(values % (2 * np.pi)), append=np.sort(values % (2 * np.pi))[0] + 2 * np.pi)
    if gaps.min() < 1e-6:
        raise ValueError(f"mode_angles={angles!r} put two modes in one direction: make all angles distinct")
    return tuple(values.tolist())


def condition_vector(theta: ArrayLike, radius: ArrayLike) -> np.ndarray:
    """The condition ``(cos theta, sin theta, r)`` (..., 3) of angles in radians and radii in metres."""
    theta, radius = np.broadcast_arrays(np.asarray(theta, np.float64), np.asarray(radius, np.float64))
    return np.stack([np.cos(theta), np.sin(theta), radius], axis=-1)


def validated_condition(condition: ArrayLike) -> np.ndarray:
    """``condition`` as float64 (..., 3).

    Raises:
        ValueError: If it is not ``(cos theta, sin theta, r)`` with a positive radius.
    """
    values = np.asarray(condition, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != 3:
        raise ValueError(
            f"a ring condition has shape {values.shape}, expected (..., 3): pass (cos theta, sin theta, r)"
        )
    # The comparisons are written so that NaN fails them.
    unit = np.abs(np.hypot(values[..., 0], values[..., 1]) - 1.0) < 1e-3
    if not np.all(unit & (values[..., 2] > 0) & np.isfinite(values[..., 2])):
        raise ValueError("a ring condition is not (cos theta, sin theta, r > 0): pass the recorded environment_state")
    return values


def mode_directions(condition: ArrayLike, angles: Sequence[float]) -> np.ndarray:
    """Unit vectors ``u_k`` (..., K, 2) towards the modes under ``condition`` (..., 3)."""
    values = validated_condition(condition)[..., None, :]
    length = np.hypot(values[..., 0], values[..., 1])
    cos_theta, sin_theta = values[..., 0] / length, values[..., 1] / length
    cos_k, sin_k = np.cos(angles), np.sin(angles)
    return np.stack([cos_theta * cos_k - sin_theta * sin_k, sin_theta * cos_k + cos_theta * sin_k], axis=-1)
