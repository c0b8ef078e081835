"""The branch flag: at which observations do the demonstrations go two ways?

A property of the data, not of any monitored policy: of the 16 training frames nearest to an observation, each mode
holds a fifth or more, and the centroids of the modes' next 16 positions lie more than 20 mm apart. Frames of foreign
data, which carry no modes, are split in two by k-means on their next displacements; as k-means splits any cloud, the
halves must then also lie four times their own spread apart (those of one Gaussian: 2.7, of a uniform cloud: 3.5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.neighbors import NearestNeighbors

from dualhead_envs.dataset_frames import SplitFrames

NEIGHBOURS, SMALLEST_SHARE, APART_MM, FUTURE = 16, 0.2, 20.0, 16
#: How many times their own spread two clusters without modes must lie apart.
SEPARATED = 4.0
#: Observed dimensions in which frames are near: joints, grip site, cube and opening; all where none has such a name.
NEAR_PREFIXES = ("joint.", "position.", "cube.position", "gripper.opening")


class BranchFlag:
    """Says of an observation whether two modes are open there.

    Args:
        frames: Observations of training frames ``(F, D)``.
        futures: Their next positions ``(F, T, d)`` in m.
        modes: Their demonstration's mode ``(F,)``, or None to tell two modes apart by k-means among the neighbours.
        columns: Dimensions of the observation to compare; all by default.

    Raises:
        ValueError: If there are fewer frames than neighbours.
    """

    def __init__(
        self,
        frames: NDArray[np.float64],
        futures: NDArray[np.float64],
        modes: NDArray[np.int64] | None = None,
        columns: Sequence[int] | None = None,
    ) -> None:
        if len(frames) < NEIGHBOURS:
            raise ValueError(f"{len(frames)} training frames given, expected at least {NEIGHBOURS}: give more data")
        self.columns = np.arange(frames.shape[1]) if columns is None else np.asarray(columns)
        near = frames[:, self.columns]
        self.mean, spread = near.mean(axis=0), near.std(axis=0)
        self.scale = np.where(spread > 1e-6, spread, np.inf)  # a constant dimension tells no frames apart
        self.futures, self.modes = futures, modes
        self._index = NearestNeighbors(n_neighbors=NEIGHBOURS).fit((near - self.mean) / self.scale)

    @classmethod
    def from_split(cls, split: SplitFrames) -> BranchFlag:
        """The flag of demonstrations as ``dualhead record`` writes them, or of any data with a dual action."""
        starts = split.window_starts(FUTURE)
        position = [i for i, name in enumerate(split.action_names) if name.startswith("position.")]
        futures = split.action[:, position][starts[:, None] + np.arange(FUTURE)].astype(np.float64)
        names = [
            name for key in split.observation for name in split.info["features"][key]["names"] or [""]
        ]  # state, then task context
        observation = np.concatenate(list(split.observation.values()), axis=1).astype(np.float64)
        columns = [i for i, name in enumerate(names) if name.startswith(NEAR_PREFIXES)]
        modes = split.labels["mode"][starts] if "mode" in split.labels else None
        return cls(observation[starts], futures, modes, columns or None)

    def __call__(self, observation: NDArray[np.float64]) -> bool:
        """Whether two modes are open at a raw observation ``(D,)``."""
        here = (observation[self.columns] - self.mean) / self.scale
        if not np.isfinite(here).all():
            return False
        near = self._index.kneighbors(here[None], return_distance=False)[0]
        futures = self.futures[near]
        if self.modes is None:
            futures = futures - futures[:, :1]
            modes = KMeans(2, n_init=1, random_state=0).fit_predict(futures.reshape(len(near), -1))
        else:
            modes = self.modes[near]
        kept = [mode for mode in np.unique(modes) if (modes == mode).mean() >= SMALLEST_SHARE]
        if len(kept) < 2:
            return False
        centroids = np.stack([futures[modes == mode].mean(axis=0) for mode in kept])
        gaps = np.linalg.norm(centroids[:, None] - centroids[None], axis=-1).mean(axis=-1)
        if self.modes is None:
            within = [futures[modes == mode] - centroid for mode, centroid in zip(kept, centroids, strict=True)]
            spread = np.sqrt(np.mean(np.concatenate([(w**2).sum(axis=-1).ravel() for w in within])))
            if gaps.max() <= SEPARATED * spread:
                return False
        return bool(1000.0 * gaps.max() > APART_MM)
