"""By side: on which side of a plane a path goes furthest."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualhead_eval.partitions.partition import PathPartition, finite


class SidePartition(PathPartition):
    r"""Two modes by the side of a plane: 0 toward its normal, 1 against it, told where the path is furthest from it.

    With signed distance ``s[h] = <x[h] - point, normal> / |normal|``, the strength is ``max_h |s[h]|`` in the path's
    unit. The rule of ``BimodalBypass-v2`` (paper, sec:mode-def), for any plane.

    >>> left_or_right = SidePartition(normal=[0, 1], tau=0.1)
    >>> left_or_right.assign([[[0, 0], [1, 0.3]], [[0, 0], [1, -0.3]], [[0, 0], [1, 0.05]]]).tolist()
    [0, 1, -1]

    Args:
        normal: Direction (d,) of mode 0, of any length but 0.
        point: A point (d,) on the plane, the origin by default.
        tau: Least distance from the plane, in the path's unit.

    Raises:
        ValueError: If shapes differ, a number is not finite, the normal is 0 or ``tau`` is not positive.
    """

    name = "side"
    n_modes = 2

    def __init__(self, normal: ArrayLike, point: ArrayLike | None = None, *, tau: float) -> None:
        super().__init__(tau)
        self.normal = direction("normal", normal)
        self.dimension = len(self.normal)
        self.point = point_like("point", point, self.dimension)

    def score_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Labels and largest distances from the plane."""
        distance = (path - self.point) @ self.normal
        toward, against = distance.max(axis=-1), -distance.min(axis=-1)
        return (against > toward).astype(np.int64), np.maximum(toward, against)

    def parameters(self) -> dict[str, Any]:
        """Normal and point."""
        return {"normal": self.normal.tolist(), "point": self.point.tolist()}


def direction(name: str, values: ArrayLike) -> np.ndarray:
    """``values`` (d,) at length 1.

    Raises:
        ValueError: If it has no direction.
    """
    vector = finite(name, values, ndim=1)
    length = np.linalg.norm(vector)
    if not np.isfinite(length) or length < 1e-300:
        raise ValueError(f"{name} is {vector.tolist()}, expected a direction: give a vector of some length")
    return vector / length


def point_like(name: str, values: ArrayLike | None, dimension: int) -> np.ndarray:
    """A point (d,), the origin for None.

    Raises:
        ValueError: If it has another dimension.
    """
    point = np.zeros(dimension) if values is None else finite(name, values, ndim=1)
    if len(point) != dimension:
        raise ValueError(f"{name} has {len(point)} numbers, expected {dimension}: give both in the space of the paths")
    return point
