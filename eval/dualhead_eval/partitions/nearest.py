"""By the nearest of K prototypes: reference paths, or end points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualhead_eval.partitions.partition import PathPartition, finite


class ReferencePartition(PathPartition):
    """K modes by the nearest of K reference paths, compared step by step.

    The distance is the mean over the steps of the Euclidean distance; references are resampled linearly to the path's
    number of steps, so that only the way counts. The strength is the simplified silhouette (Rousseeuw 1987) of
    :func:`silhouette`, in 0..1.

    >>> two_ways = ReferencePartition([[[0, 0], [1, 1], [2, 0]], [[0, 0], [1, -1], [2, 0]]], tau=0.2)
    >>> two_ways.assign([[[0, 0], [1, 0.8], [2, 0]], [[0, 0], [1, -0.9], [2, 0]], [[0, 0], [1, 0], [2, 0]]]).tolist()
    [0, 1, -1]

    Args:
        references: The paths (K, H, d).
        tau: Least silhouette, above 0.

    Raises:
        ValueError: If there are fewer than two different references, or a number is not finite.
    """

    name = "reference"

    def __init__(self, references: ArrayLike, *, tau: float = 0.2) -> None:
        super().__init__(tau)
        self.references = finite("references", references, ndim=3)
        check_prototypes("references", self.references)
        self.n_modes, _, self.dimension = self.references.shape

    def score_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest references and silhouettes."""
        references = resample(self.references, path.shape[-2])
        distances = [np.linalg.norm(path - reference, axis=-1).mean(axis=-1) for reference in references]
        return silhouette(np.stack(distances, axis=-1))

    def parameters(self) -> dict[str, Any]:
        """The references."""
        return {"references": self.references.tolist()}


class EndpointPartition(PathPartition):
    """K modes by the nearest of K centres to a path's last point; :meth:`fit` finds the centres.

    The strength is the simplified silhouette of :func:`silhouette`, in 0..1. Clustering finds K clusters in any data,
    also where there is one mode: look at them before reading a verdict.

    >>> goals = EndpointPartition.fit([[[0, 0], [1, 1.1]], [[0, 0], [1, 0.9]], [[0, 0], [1, -1]]], n_modes=2, seed=0)
    >>> goals.centers.round(6).tolist()
    [[1.0, -1.0], [1.0, 1.0]]
    >>> goals.assign([[[0, 0], [1, 0.8]], [[0, 0], [1, -1.3]], [[0, 0], [1, 0.1]]]).tolist()
    [1, 0, -1]

    Args:
        centers: The centres (K, d).
        tau: Least silhouette, above 0.

    Raises:
        ValueError: If there are fewer than two different centres, or a number is not finite.
    """

    name = "endpoint"

    def __init__(self, centers: ArrayLike, *, tau: float = 0.2) -> None:
        super().__init__(tau)
        self.centers = finite("centers", centers, ndim=2)
        check_prototypes("centers", self.centers)
        self.n_modes, self.dimension = self.centers.shape

    @classmethod
    def fit(cls, path: ArrayLike, n_modes: int, *, tau: float = 0.2, seed: int) -> EndpointPartition:
        """Centres of the end points of paths (..., H, d) by k-means, in lexicographic order.

        Args:
            path: Paths of demonstrations or samples.
            n_modes: Number of modes K.
            tau: Least silhouette.
            seed: Seed of k-means and its ten restarts.

        Raises:
            ValueError: If there are fewer than K different end points.
        """
        from sklearn.cluster import KMeans

        points = finite("path", path)
        if points.ndim < 2 or points.size == 0:
            raise ValueError(f"path has shape {points.shape}, expected (..., H, d): pass positions, one row a step")
        ends = points[..., -1, :].reshape(-1, points.shape[-1])
        different = len(np.unique(ends, axis=0))
        if not 2 <= n_modes <= different:
            raise ValueError(
                f"{n_modes} modes asked of {different} different end points, expected at least 2 and no more than "
                "these: ask for fewer modes or give more paths"
            )
        centers = KMeans(n_modes, n_init=10, random_state=seed).fit(ends).cluster_centers_
        return cls(centers[np.lexsort(centers.T[::-1])], tau=tau)

    def score_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest centres and silhouettes."""
        return silhouette(np.linalg.norm(path[..., -1, None, :] - self.centers, axis=-1))

    def parameters(self) -> dict[str, Any]:
        """The centres."""
        return {"centers": self.centers.tolist()}


def silhouette(distances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest prototypes and simplified silhouettes ``1 - nearest / second nearest`` (Rousseeuw 1987).

    1 at a prototype, 0 where two are equally near, and near 0 far away from all of them.

    >>> label, strength = silhouette(np.array([[0.0, 2.0], [3.0, 1.5], [1.0, 1.0], [0.0, 0.0]]))
    >>> label.tolist(), strength.tolist()
    ([0, 1, 0, 0], [1.0, 0.5, 0.0, 0.0])

    Args:
        distances: Distances to the prototypes (..., K), at least 0.
    """
    nearest, second = np.moveaxis(np.partition(distances, 1, axis=-1)[..., :2], -1, 0)
    ratio = np.divide(nearest, second, where=second > 0, out=np.ones_like(second))
    return distances.argmin(axis=-1), 1.0 - ratio


def resample(paths: np.ndarray, steps: int) -> np.ndarray:
    """Paths (K, H, d) at ``steps`` equally spaced times, linearly between theirs; the last point for one step.

    >>> resample(np.array([[[0.0], [2.0]]]), 3).ravel().tolist()
    [0.0, 1.0, 2.0]
    """
    if steps == paths.shape[1]:
        return paths
    times = np.linspace(0, paths.shape[1] - 1, steps) if steps > 1 else np.array([paths.shape[1] - 1.0])
    low = np.floor(times).astype(int)
    high = np.minimum(low + 1, paths.shape[1] - 1)
    share = (times - low)[:, None]
    return (1 - share) * paths[:, low] + share * paths[:, high]


def check_prototypes(name: str, prototypes: np.ndarray) -> None:
    """Refuse fewer than two prototypes, or two that are the same.

    Raises:
        ValueError: If that is so.
    """
    different = len(np.unique(prototypes.reshape(len(prototypes), -1), axis=0))
    if len(prototypes) < 2 or different < len(prototypes):
        raise ValueError(
            f"{name} are {len(prototypes)} of which {different} differ, expected two or more that all differ: give one "
            "per mode"
        )
