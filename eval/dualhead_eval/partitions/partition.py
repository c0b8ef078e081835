"""The protocol of a mode partition, and the base of those that need no code.

A partition maps paths to modes. What this project asks of one is :class:`Partition`, four names; anything that has them
can be evaluated. A partition whose labels come from comparing a strength with tau derives from :class:`PathPartition`,
gives :meth:`PathPartition.score`, and can then be counted at several thresholds at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike


@runtime_checkable
class Partition(Protocol):
    """What a partition of one's own must have.

    Attributes:
        n_modes: Number of modes K, at least 2.
        tau: Threshold below which a path is invalid.
    """

    n_modes: int
    tau: float

    def assign(self, path: ArrayLike, condition: ArrayLike, tau: float | None = None) -> np.ndarray:
        """Labels (...) int64 of ``path`` (..., H, d) under ``condition`` (..., C): 0..K-1, or -1 if invalid."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """JSON description for gate files: ``name``, ``n_modes``, ``tau``, ``parameters``."""
        ...


class PathPartition(ABC):
    """A partition of paths by a score; what a subclass says of paths holds under every condition.

    Attributes:
        name: What the partition is called in gate files.
        n_modes: Number of modes K.
        dimension: Coordinates d of a path's points.
        tau: Threshold that strengths are compared with, above 0.
    """

    name: str
    n_modes: int
    dimension: int

    def __init__(self, tau: float) -> None:
        self.tau = positive("tau", tau)

    @abstractmethod
    def score_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Labels (...) int64 before thresholding and strengths (...) float64 of finite paths (..., H, d)."""

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """What the partition was built from besides tau, as plain JSON."""

    def score(self, path: ArrayLike, condition: ArrayLike = ()) -> tuple[np.ndarray, np.ndarray]:
        """Labels before thresholding and strengths: :meth:`assign` keeps a label where strength >= tau.

        Args:
            path: Points (..., H, d), H at least 1.
            condition: (..., C); only its leading axes matter, which broadcast with those of ``path``.

        Raises:
            ValueError: If shapes do not fit or a number is not finite.
        """
        points = finite("path", path)
        if points.ndim < 2 or points.shape[-1] != self.dimension or points.shape[-2] == 0:
            raise ValueError(
                f"path has shape {points.shape}, expected (..., H, {self.dimension}): pass positions, one row a step"
            )
        leading = np.broadcast_shapes(points.shape[:-2], np.shape(condition)[:-1])
        label, strength = self.score_paths(points)
        return np.broadcast_to(label, leading).copy(), np.broadcast_to(strength, leading).copy()

    def assign(self, path: ArrayLike, condition: ArrayLike = (), tau: float | None = None) -> np.ndarray:
        """Labels (...) int64 of ``path`` (..., H, d): 0..K-1, or -1 if invalid.

        Args:
            path: Points (..., H, d).
            condition: (..., C), for its leading axes.
            tau: Threshold, the partition's own by default.

        Raises:
            ValueError: As :meth:`score`, or if ``tau`` is not positive.
        """
        label, strength = self.score(path, condition)
        return np.where(strength >= (self.tau if tau is None else positive("tau", tau)), label, -1)

    def to_dict(self) -> dict[str, Any]:
        """JSON description, from which :func:`~dualhead_eval.partitions.partition_file.build_partition` builds it."""
        return {"name": self.name, "n_modes": self.n_modes, "tau": self.tau, "parameters": self.parameters()}


def positive(name: str, value: float) -> float:
    """``value`` as a positive number.

    Raises:
        ValueError: If it is none.
    """
    if not (np.isscalar(value) and np.isfinite(value) and value > 0):
        raise ValueError(f"{name} is {value!r}, expected a positive number: choose one on the scale of the paths")
    return float(value)


def finite(name: str, values: ArrayLike, ndim: int | None = None) -> np.ndarray:
    """``values`` as float64.

    Raises:
        ValueError: If a number is not finite, or the array has not ``ndim`` axes.
    """
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinite numbers, expected finite ones: drop or repair these first")
    if ndim is not None and (array.ndim != ndim or array.size == 0):
        raise ValueError(f"{name} has shape {array.shape}, expected {ndim} axes and at least one number: reshape it")
    return array
