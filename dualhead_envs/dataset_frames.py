"""Read one split of a demonstration dataset into memory, straight from its Parquet files.

LeRobotDataset fetches one window at a time, which suits images and is slow for vectors; training on states
and evaluating need whole columns. Nothing here imports LeRobot.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_envs.dataset_columns import INFO, data_files, read_columns, read_info
from dualhead_envs.dataset_sidecar import SIDECAR, read_sidecar
from dualhead_envs.validated_json import LONGEST_LABEL, shown

OBSERVATION_KEYS = ("observation.state", "observation.environment_state")
LABEL_KEYS = ("mode", "pair", "branch_step")


@dataclass(frozen=True)
class Conditions:
    """Evaluation conditions: the branch point of every pair.

    Attributes:
        observation: Raw observations by LeRobot key, each (B, dim) float32.
        pair: Pair ids (B,).
        frame: Where each lies among the split's frames (B,).
    """

    observation: dict[str, np.ndarray]
    pair: np.ndarray
    frame: np.ndarray

    def __len__(self) -> int:
        return len(self.pair)


@dataclass(frozen=True)
class SplitFrames:
    """All frames of one split, in order of the global index.

    Attributes:
        root: The LeRobotDataset's folder.
        info: ``meta/info.json``.
        sidecar: ``meta/dualhead.json`` (environment id, partition, prior, seeds).
        observation: Raw observations by LeRobot key, each (F, dim) float32.
        action: The dual action vector (F, D) float32; row t is the measured state at t + 1.
        episode_index: (F,) int64.
        frame_index: (F,) int64, from 0 in each episode.
        labels: ``mode``, ``pair`` and ``branch_step`` columns, each (F,) int64.
    """

    root: Path
    info: dict[str, Any]
    sidecar: dict[str, Any]
    observation: dict[str, np.ndarray]
    action: np.ndarray
    episode_index: np.ndarray
    frame_index: np.ndarray
    labels: dict[str, np.ndarray]

    @property
    def action_names(self) -> list[str]:
        """Names of the dual action vector's dimensions."""
        return list(self.info["features"]["action"]["names"])

    def window_starts(self, horizon: int) -> np.ndarray:
        """Frames (N,) at which a window of ``horizon`` actions fits into the episode."""
        last = np.zeros(int(self.episode_index.max()) + 1, dtype=np.int64)
        np.maximum.at(last, self.episode_index, self.frame_index)
        return np.flatnonzero(self.frame_index + horizon - 1 <= last[self.episode_index])

    def conditions(self) -> Conditions:
        """The branch point of every pair: what its demonstrations share just before they separate."""
        at_branch = np.flatnonzero(self.frame_index == self.labels["branch_step"])
        pair, first = np.unique(self.labels["pair"][at_branch], return_index=True)
        frames = at_branch[first]
        return Conditions({key: column[frames] for key, column in self.observation.items()}, pair, frames)

    def history(self, frames: np.ndarray, steps: int) -> dict[str, np.ndarray]:
        """The last ``steps`` observations at ``frames`` (B,), the present one last: each (B, steps, dim).

        Before an episode's first frame that frame is repeated, as LeRobot does in training.
        """
        back = np.arange(1 - steps, 1)
        within = np.maximum(self.frame_index[frames, None] + back, 0)
        rows = frames[:, None] - self.frame_index[frames, None] + within
        return {key: column[rows] for key, column in self.observation.items()}

    def mode_windows(self, horizon: int, prefix: str = "position.") -> np.ndarray | None:
        """Actions of every pair's demonstrations after the branch, by mode: (B, K, horizon, d).

        Pairs are ordered as in :meth:`conditions`. None if a pair lacks a mode or a whole window.

        Args:
            horizon: Steps of a window.
            prefix: Of the action dimensions' names: ``"position."`` (m) or ``"joint."`` (rad on robots).
        """
        columns = [i for i, name in enumerate(self.action_names) if name.startswith(prefix)]
        at_branch = np.flatnonzero(self.frame_index == self.labels["branch_step"])
        pairs, row = np.unique(self.labels["pair"][at_branch], return_inverse=True)
        mode = self.labels["mode"][at_branch]
        if (mode < 0).any() or not np.isin(at_branch, self.window_starts(horizon)).all():
            return None
        first = np.full((len(pairs), int(mode.max()) + 1), -1)
        first[row, mode] = at_branch
        if (first < 0).any():
            return None
        return self.action[:, columns][first[..., None] + np.arange(horizon)].astype(np.float64)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the Parquet data files, in order."""
        digest = hashlib.sha256()
        for path in data_files(self.root):
            digest.update(path.read_bytes())
        return digest.hexdigest()


def read_split(root: str | Path) -> SplitFrames:
    """Read the demonstrations of one split.

    Args:
        root: A LeRobotDataset v3.0 folder, as ``dualhead record`` writes it (for example ``data/ring/train``).

    Raises:
        FileNotFoundError: If the folder holds no such dataset.
        ValueError: If a feature is missing, or an action or observation is not finite.
    """
    root = Path(root)
    info = read_info(root)
    sidecar = read_sidecar(root)
    wanted = ["action", "episode_index", "frame_index"]
    wanted += [key for key in (*OBSERVATION_KEYS, *LABEL_KEYS) if key in info["features"]]
    missing = [key for key in wanted[:3] if key not in info["features"]]
    if missing or not any(key in wanted for key in OBSERVATION_KEYS):
        raise ValueError(
            f"{root} lacks the features {missing or list(OBSERVATION_KEYS)}: "
            "expected a dataset written by `dualhead record`"
        )
    _check_names(root, info["features"]["action"], sidecar.get("layout"))
    columns = read_columns(root, info, wanted)
    check_frames(root, columns, info["total_episodes"], sidecar.get("partition", {}).get("n_modes"))
    return SplitFrames(
        root=root,
        info=info,
        sidecar=sidecar,
        observation={key: columns[key] for key in OBSERVATION_KEYS if key in columns},
        action=columns["action"],
        episode_index=columns["episode_index"],
        frame_index=columns["frame_index"],
        labels={key: columns[key] for key in LABEL_KEYS if key in columns},
    )


def _check_names(root: Path, action: Mapping[str, Any], layout: str | None) -> None:
    """Refuse an action whose dimensions are not named, or not as the layout that the dataset says it has."""
    names, width = action.get("names"), action["shape"]
    if not isinstance(names, list) or [len(names)] != width or not all(_is_name(name) for name in names):
        raise ValueError(
            f"{root / INFO} names the dimensions of the action {shown(names)}, expected a list of {width} names: "
            "record the dataset again"
        )
    # joint.MAP.i on the ring, joint.i on robots.
    parts = names[0].split(".")
    implied = f"ring/{parts[1]}" if len(parts) == 3 else "panda"
    if layout is not None and layout != implied:
        raise ValueError(
            f"{root / SIDECAR} has layout = {shown(layout)}, the names of the actions are those of {implied!r}: record "
            "the dataset again"
        )


def _is_name(name: Any) -> bool:
    return isinstance(name, str) and 0 < len(name) <= LONGEST_LABEL and name.isprintable()


def check_frames(root: Path, columns: Mapping[str, np.ndarray], episodes: int, n_modes: int | None) -> None:
    """Refuse frames whose numbers are not finite, or whose episodes, modes or branch points contradict each other.

    Args:
        root: The dataset's folder, for errors.
        columns: Columns by feature key, in order of the global index.
        episodes: Number of episodes that the dataset declares.
        n_modes: Number of modes, or None if the dataset does not say.

    Raises:
        ValueError: In one sentence about the first contradiction.
    """
    for key in ("action", *OBSERVATION_KEYS):
        if key in columns and not np.isfinite(columns[key]).all():
            bad = int(np.flatnonzero(~np.isfinite(columns[key]).all(axis=1))[0])
            raise ValueError(
                f"{root} holds a non-finite value in {key!r} at frame {bad}: expected finite numbers; "
                "record the dataset again or drop that episode"
            )
    episode, frame = columns["episode_index"], columns["frame_index"]
    begins = np.diff(episode, prepend=-1)
    lengths = np.bincount(np.clip(episode, 0, None), minlength=1)
    within = np.arange(len(episode)) - np.maximum.accumulate(np.where(begins == 1, np.arange(len(episode)), 0))
    if not np.isin(begins, (0, 1)).all() or episode[-1] != episodes - 1 or (frame != within).any():
        raise ValueError(
            f"{root} does not hold {episodes} episodes one after the other, each from frame 0: record the dataset again"
        )
    limits = {"mode": (-1, n_modes), "pair": (0, None), "branch_step": (-1, lengths[episode])}
    for key, (low, high) in limits.items():
        if key in columns and ((columns[key] < low).any() or (high is not None and (columns[key] >= high).any())):
            raise ValueError(
                f"{root} holds {key} from {columns[key].min()} to {columns[key].max()}, expected from {low} to below "
                f"{'the length of the episode' if key == 'branch_step' else high}: record the dataset again"
            )
