"""The mode partitions of the bypass environments: on which side, or by which route, a path goes past.

All label the path of the grip site, in metres in the world frame, and all have a peak over the path as their
strength: a path is valid where that peak reaches tau. They read nothing but geometry; collisions are the
environment's to report.
"""

from __future__ import annotations

import abc
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualhead_envs.bypass.task import ROUTE_CENTER, ROUTE_FLATTENING, ROUTE_YAW

#: The paper's thresholds in metres (sec:envs), matched by the independent family's coverage.
BIMODAL_TAU = 0.11
ROTATING_TAU = 0.18
#: How many numbers of ``environment_state`` hold v3's routes: R, cos(phi), sin(phi), the last three.
ROUTE_NUMBERS = 3


class BypassPartition(abc.ABC):
    """Modes (two, unless a subclass says otherwise), a threshold, and the rule that it gives in :meth:`score`."""

    name: str
    n_modes = 2

    def __init__(self, tau: float) -> None:
        self.tau = _threshold(tau)

    @abc.abstractmethod
    def score(self, path: ArrayLike, condition: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Labels (...) int64 before thresholding, and strengths (...) float64 in metres."""

    @abc.abstractmethod
    def score_point(self, point: np.ndarray, condition: np.ndarray) -> tuple[int, float]:
        """:meth:`score` of a path of one finite point (3,), in a microsecond; a path's score is its best point's."""

    def assign(self, path: ArrayLike, condition: ArrayLike, tau: float | None = None) -> np.ndarray:
        """Labels (...) int64 of ``path`` (..., H, 3) under ``condition`` (..., C): a mode, or -1 if invalid.

        Args:
            path: Positions of the grip site in metres, world frame.
            condition: ``environment_state`` vectors, broadcast over leading axes.
            tau: Threshold in metres, the partition's own by default.

        Raises:
            ValueError: If shapes do not fit, a number is not finite, or ``tau`` is not positive.
        """
        label, strength = self.score(path, condition)
        return np.where(strength >= (self.tau if tau is None else _threshold(tau)), label, -1)

    def to_dict(self) -> dict[str, Any]:
        """JSON description for gate files and datasets."""
        return {"name": self.name, "n_modes": self.n_modes, "tau": self.tau, "parameters": self._parameters()}

    def _parameters(self) -> dict[str, Any]:
        return {}


class BimodalPartition(BypassPartition):
    """v2: the sign of y where \\|y\\| is largest; 0 is left (y > 0), 1 is right (paper, sec:mode-def).

    The strength is that largest \\|y\\|. The condition is not used: the wall stands where it stands.
    """

    name = "bypass-v2"

    def __init__(self, tau: float = BIMODAL_TAU) -> None:
        super().__init__(tau)

    def score(self, path: ArrayLike, condition: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Labels (...) and strengths (...) of ``path`` (..., H, 3); leading axes broadcast with the condition's.

        Raises:
            ValueError: If shapes do not fit or a number is not finite.
        """
        lateral = _positions(path)[..., 1]
        leading = np.broadcast_shapes(lateral.shape[:-1], _condition(condition).shape[:-1])
        left, right = lateral.max(axis=-1), -lateral.min(axis=-1)
        label = (right > left).astype(np.int64)
        strength = np.maximum(left, right)
        return np.broadcast_to(label, leading).copy(), np.broadcast_to(strength, leading).copy()

    def score_point(self, point: np.ndarray, condition: np.ndarray) -> tuple[int, float]:
        """Label and strength of one point (3,)."""
        y = float(point[1])
        return (1, -y) if y < 0.0 else (0, y)


class ThreeWayPartition(BypassPartition):
    """v2 with three ways: the largest of three projections on the whitened cross-section; 0 left, 1 right, 2 over.

    The cross-section is v3's, ``w = (y, (z - 0.955) / 0.68)``: it has its origin at the lift pose, where the ways part,
    and measures all three ways by one length, since the expert's three apexes lie equally far from it. A way's
    projection is ``y``, ``-y`` or ``(z - 0.955) / 0.68``; the label is the way whose peak over the path is largest, and
    that peak, in metres, is the strength.

    Why one tau for all, and why 0.11 m. The demonstrated windows peak at 0.165 m in every way, and 0.11 m is two thirds
    of that: a blend of several ways, which leads into the wall, is invalid unless one of them makes up two thirds of
    it. It is also where the carried cube (half an edge of 0.021 m) is past the wall's edge (0.09 m) on either side;
    over the wall it asks for a grip site at z = 1.030 m, with the cube's lower side 29 mm above the wall (0.98 m).
    Invalid is everything that stays within 0.11 m of the lift pose in all three directions, and whatever goes down.
    """

    name = "bypass-v2-three-ways"
    n_modes = 3

    def __init__(self, tau: float = BIMODAL_TAU) -> None:
        super().__init__(tau)

    def score(self, path: ArrayLike, condition: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Labels (...) and strengths (...) of ``path`` (..., H, 3); leading axes broadcast with the condition's.

        Raises:
            ValueError: If shapes do not fit or a number is not finite.
        """
        points = _positions(path)
        leading = np.broadcast_shapes(points.shape[:-2], _condition(condition).shape[:-1])
        lateral = points[..., 1] - ROUTE_CENTER[0]
        rise = (points[..., 2] - ROUTE_CENTER[1]) / ROUTE_FLATTENING
        peaks = np.stack([lateral.max(axis=-1), -lateral.min(axis=-1), rise.max(axis=-1)])
        label, strength = peaks.argmax(axis=0), peaks.max(axis=0)
        return np.broadcast_to(label, leading).copy(), np.broadcast_to(strength, leading).copy()

    def score_point(self, point: np.ndarray, condition: np.ndarray) -> tuple[int, float]:
        """Label and strength of one point (3,)."""
        y = float(point[1]) - ROUTE_CENTER[0]
        rise = (float(point[2]) - ROUTE_CENTER[1]) / ROUTE_FLATTENING
        if rise > abs(y):
            return 2, rise
        return (1, -y) if y < 0.0 else (0, y)

    def _parameters(self) -> dict[str, Any]:
        return {"center": list(ROUTE_CENTER), "flattening": ROUTE_FLATTENING}


class RotatingPartition(BypassPartition):
    """v3: the larger of two orthogonal projections on the whitened cross-section (paper, sec:mode-def).

    The cross-section is ``w = (y, (z - 0.955) / 0.68)``; mode k lies along ``(cos, sin)(phi + k pi / 2)``, where
    phi is the condition's. The label is the mode with the largest peak projection over the path, and that peak, in
    metres, is the strength.
    """

    name = "rotating-v3"

    def __init__(self, tau: float = ROTATING_TAU) -> None:
        super().__init__(tau)

    def score(self, path: ArrayLike, condition: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Labels (...) and strengths (...) of ``path`` (..., H, 3) under ``condition`` (..., C).

        Raises:
            ValueError: If shapes do not fit, a number is not finite, or the condition holds no route.
        """
        points = _positions(path)
        cosine, sine = _route(condition)
        y = points[..., 1] - ROUTE_CENTER[0]
        z = (points[..., 2] - ROUTE_CENTER[1]) / ROUTE_FLATTENING
        cosine, sine = cosine[..., None], sine[..., None]
        first = (y * cosine + z * sine).max(axis=-1)
        second = (z * cosine - y * sine).max(axis=-1)
        return (second > first).astype(np.int64), np.maximum(first, second)

    def score_point(self, point: np.ndarray, condition: np.ndarray) -> tuple[int, float]:
        """Label and strength of one point (3,); ``condition`` ends with (R, cos phi, sin phi)."""
        cosine, sine = float(condition[-2]), float(condition[-1])
        y = float(point[1]) - ROUTE_CENTER[0]
        z = (float(point[2]) - ROUTE_CENTER[1]) / ROUTE_FLATTENING
        first, second = y * cosine + z * sine, z * cosine - y * sine
        return (1, second) if second > first else (0, first)

    def assign_rotation(self, rotation: ArrayLike, condition: ArrayLike) -> np.ndarray:
        """The companion rule of an orientation head: the mode whose yaw is nearest the mean (tab:pose).

        Args:
            rotation: First two columns of the grip site's rotation matrix (..., H, 6), world frame.
            condition: ``environment_state`` vectors (..., C).

        Returns:
            Labels (...) int64, 0 or 1. Mode k's yaw is 0.45 cos(phi + k pi / 2) rad from the start's; both modes
            reach it by the same schedule, so the nearer is told by the sign of the deviation from their mean.

        Raises:
            ValueError: If shapes do not fit or a number is not finite.
        """
        columns = np.asarray(rotation, dtype=np.float64)
        if columns.ndim < 2 or columns.shape[-1] != 6 or not np.isfinite(columns).all():
            raise ValueError(
                f"rotation has shape {columns.shape}, expected finite (..., H, 6): "
                "pass the first two columns of rotation matrices"
            )
        # At the start the grip site's first column points along -x: yaw is measured from there.
        yaw = np.arctan2(-columns[..., 1], -columns[..., 0]).mean(axis=-1)
        cosine, sine = _route(condition)
        middle = 0.5 * ROUTE_YAW * YAW_SHARE * (cosine - sine)
        # cos(phi) > -sin(phi) for phi in [0, pi/2): mode 0 always has the larger yaw.
        return (yaw < middle).astype(np.int64)

    def _parameters(self) -> dict[str, Any]:
        return {"center": list(ROUTE_CENTER), "flattening": ROUTE_FLATTENING}


#: Mean over the 16-step window of the demonstrated yaw, as a share of the route's full yaw (measured).
YAW_SHARE = 0.60


def _positions(path: ArrayLike) -> np.ndarray:
    points = np.asarray(path, dtype=np.float64)
    if points.ndim < 2 or points.shape[-1] != 3 or points.shape[-2] == 0:
        raise ValueError(f"path has shape {points.shape}, expected (..., H, 3): pass positions, one row a step")
    if not np.isfinite(points).all():
        raise ValueError("path holds NaN or infinite positions: drop or repair these samples before labelling")
    return points


def _condition(condition: ArrayLike) -> np.ndarray:
    state = np.asarray(condition, dtype=np.float64)
    if state.ndim < 1 or not np.isfinite(state).all():
        raise ValueError(
            f"condition has shape {state.shape} or a number that is not finite, expected finite (..., C): "
            "pass environment_state vectors"
        )
    return state


def _route(condition: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    state = _condition(condition)
    if state.shape[-1] < ROUTE_NUMBERS:
        raise ValueError(
            f"condition has {state.shape[-1]} numbers, expected RotatingBypass-v3's environment_state, which ends "
            "with (R, cos phi, sin phi)"
        )
    cosine, sine = state[..., -2], state[..., -1]
    if np.abs(np.hypot(cosine, sine) - 1.0).max(initial=0.0) > 1e-3:
        raise ValueError(
            "the last two numbers of the condition are not a cosine and a sine, expected RotatingBypass-v3's "
            "environment_state, which ends with (R, cos phi, sin phi): pass unnormalised conditions"
        )
    return cosine, sine


def _threshold(tau: float) -> float:
    if not (np.isfinite(tau) and tau > 0):
        raise ValueError(f"tau={tau!r} should be a positive length in metres, for example {BIMODAL_TAU}")
    return float(tau)
