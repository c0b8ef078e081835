"""By waypoint plane: through which gap a path crosses a plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualhead_eval.partitions.partition import PathPartition, finite
from dualhead_eval.partitions.side import direction, point_like


class CrossingPartition(PathPartition):
    """K modes by where a path first crosses a waypoint plane: the doors of a wall, the lanes of a road.

    ``boundaries`` cut the plane along ``across`` into K gaps; mode 0 lies below the first. The crossing point is
    interpolated linearly between the two steps around it. The strength is its distance from the nearest boundary, in
    the path's unit; a path that does not cross is invalid at every threshold.

    >>> doors = CrossingPartition(normal=[1, 0], point=[0.5, 0], across=[0, 1], boundaries=[-1, 1], tau=0.1)
    >>> doors.n_modes
    3
    >>> doors.assign([[[0, 0], [1, -4]], [[0, 0], [1, 0]], [[0, 0], [1, 4]], [[0, 0], [0.4, 4]]]).tolist()
    [0, 1, 2, -1]

    Args:
        normal: Normal (d,) of the waypoint plane.
        point: A point (d,) on it, the origin by default.
        across: Direction (d,) along which the gaps lie; what of it is parallel to the normal is removed.
        boundaries: Increasing coordinates along ``across``, measured from ``point``; K - 1 of them.
        tau: Least distance from a boundary.

    Raises:
        ValueError: If shapes differ, a number is not finite, directions are parallel, or boundaries do not increase.
    """

    name = "crossing"

    def __init__(
        self,
        normal: ArrayLike,
        across: ArrayLike,
        point: ArrayLike | None = None,
        boundaries: Sequence[float] = (0.0,),
        *,
        tau: float,
    ) -> None:
        super().__init__(tau)
        self.normal = direction("normal", normal)
        self.dimension = len(self.normal)
        self.point = point_like("point", point, self.dimension)
        along = direction("across", across)
        if len(along) != self.dimension or abs(along @ self.normal) > 1 - 1e-9:
            raise ValueError(
                f"across is {along.tolist()} and normal {self.normal.tolist()}, expected directions of one space that "
                "differ: give a direction within the plane"
            )
        self.across = direction("across", along - (along @ self.normal) * self.normal)
        self.boundaries = finite("boundaries", boundaries, ndim=1)
        if (np.diff(self.boundaries) <= 0).any():
            raise ValueError(f"boundaries are {self.boundaries.tolist()}, expected increasing numbers: sort them")
        self.n_modes = len(self.boundaries) + 1

    def score_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Labels and distances of the first crossing from the nearest boundary; -inf without one."""
        offset = path - self.point
        ahead, along = offset @ self.normal, offset @ self.across
        crosses = (ahead[..., :-1] < 0) != (ahead[..., 1:] < 0)
        if crosses.shape[-1] == 0:
            return np.zeros(crosses.shape[:-1], dtype=np.int64), np.full(crosses.shape[:-1], -np.inf)
        step = crosses.argmax(axis=-1)[..., None]
        before, after = (np.take_along_axis(ahead, step + k, axis=-1)[..., 0] for k in (0, 1))
        start, end = (np.take_along_axis(along, step + k, axis=-1)[..., 0] for k in (0, 1))
        some = crosses.any(axis=-1)
        share = np.divide(before, before - after, where=some, out=np.zeros_like(before))
        place = start + share * (end - start)
        strength = np.abs(place[..., None] - self.boundaries).min(axis=-1)
        return np.searchsorted(self.boundaries, place, side="right"), np.where(some, strength, -np.inf)

    def parameters(self) -> dict[str, Any]:
        """Plane, direction across it and boundaries."""
        return {
            "normal": self.normal.tolist(),
            "across": self.across.tolist(),
            "point": self.point.tolist(),
            "boundaries": self.boundaries.tolist(),
        }
