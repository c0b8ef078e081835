"""The reconciled residual: how far apart the two decodings of one motion are (sec:residual-def).

Positions in metres, residuals in millimetres; rotations as the first two columns of the rotation matrix,
residuals in degrees. The lateral part lies along the direction that separates the modes, the orthogonal part
across it (sec:tautology).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def position_residual_mm(path_a: ArrayLike, path_b: ArrayLike) -> NDArray[np.float64]:
    """Mean over the window of the distance between two paths ``(..., H, d)`` in metres, in millimetres
    ``(...)``.

    Raises:
        ValueError: If the shapes differ.
    """
    return 1000 * np.linalg.norm(_difference(path_a, path_b), axis=-1).mean(axis=-1)


def split_residual_mm(
    path_a: ArrayLike, path_b: ArrayLike, direction: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lateral and orthogonal residuals in millimetres.

    Args:
        path_a: Path in metres, ``(..., H, d)``.
        path_b: The other decoding.
        direction: Direction that separates the modes, ``(..., d)``, any length but zero.

    Raises:
        ValueError: If shapes differ or a direction is zero.
    """
    difference = _difference(path_a, path_b)
    u = np.asarray(direction, dtype=np.float64)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise ValueError("direction is zero or NaN, expected a vector from one mode to the other")
    u = (u / length)[..., None, :]
    along = (difference * u).sum(axis=-1, keepdims=True)
    lateral = 1000 * np.abs(along[..., 0]).mean(axis=-1)
    orthogonal = 1000 * np.linalg.norm(difference - along * u, axis=-1).mean(axis=-1)
    return lateral, orthogonal


def mode_direction(paths: ArrayLike) -> NDArray[np.float64]:
    """The direction along which a condition's modes differ most: the lateral one.

    Args:
        paths: One demonstration (or mean path) a mode in metres, ``(..., K, H, d)``.

    Returns:
        Unit vectors ``(..., d)``, up to sign: the first principal axis of the modes' deviations from their
        common path; with two modes and a straight separation, the line from one to the other.

    Raises:
        ValueError: If fewer than two modes are given.
    """
    x = np.asarray(paths, dtype=np.float64)
    if x.ndim < 3 or x.shape[-3] < 2:
        raise ValueError(f"paths have shape {x.shape}, expected (..., K, H, d) with two modes or more")
    deviations = x - x.mean(axis=-3, keepdims=True)
    flat = deviations.reshape(*x.shape[:-3], -1, x.shape[-1])
    return np.linalg.eigh(np.swapaxes(flat, -1, -2) @ flat)[1][..., -1]


def rotation_residual_deg(rotation_a: ArrayLike, rotation_b: ArrayLike) -> NDArray[np.float64]:
    """Mean over the window of the geodesic angle between 6-D rotations ``(..., H, 6)``, in degrees ``(...)``.

    Raises:
        ValueError: If shapes differ or do not end in 6.
    """
    _difference(rotation_a, rotation_b)
    a, b = rotation_matrices(rotation_a), rotation_matrices(rotation_b)
    relative = np.swapaxes(a, -1, -2) @ b
    # atan2 of sine and cosine keeps small angles that arccos of the trace would lose.
    skew = np.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.linalg.norm(skew, axis=-1)
    cosine = 0.5 * (np.trace(relative, axis1=-2, axis2=-1) - 1)
    return np.degrees(np.arctan2(sine, cosine)).mean(axis=-1)


def rotation_matrices(rotation: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices ``(..., 3, 3)`` from 6-D rotations ``(..., 6)`` (first two columns, Gram-Schmidt).

    Raises:
        ValueError: If the last axis is not 6.
    """
    r = np.asarray(rotation, dtype=np.float64)
    if r.shape[-1:] != (6,):
        raise ValueError(f"rotation has shape {r.shape}, expected (..., 6): the first two columns of the matrix")
    x = r[..., :3] / np.linalg.norm(r[..., :3], axis=-1, keepdims=True)
    y = r[..., 3:] - (x * r[..., 3:]).sum(axis=-1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def nearest_yaw_labels(rotation: ArrayLike, mode_yaws: ArrayLike) -> NDArray[np.int64]:
    """Companion rule of an orientation head: the mode whose mean yaw is nearest (tab:pose).

    Args:
        rotation: 6-D rotations over the window, ``(..., H, 6)``.
        mode_yaws: Mean yaw of each mode in radians, ``(..., K)``.

    Returns:
        Labels 0..K-1, ``(...)``; the first mode on a tie.
    """
    forward = rotation_matrices(rotation)[..., 0].mean(axis=-2)
    yaw = np.arctan2(forward[..., 1], forward[..., 0])
    gap = np.asarray(mode_yaws, dtype=np.float64) - yaw[..., None]
    return np.abs(np.angle(np.exp(1j * gap))).argmin(axis=-1)


def _difference(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if x.shape != y.shape or x.ndim < 2:
        raise ValueError(f"paths have shapes {x.shape} and {y.shape}, expected one shape (..., H, d)")
    return x - y
