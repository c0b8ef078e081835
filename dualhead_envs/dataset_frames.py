"""Read one split of a demonstration dataset into memory, straight from its Parquet files.

LeRobotDataset fetches one window at a time, which suits images and is slow for vectors; training on states
and evaluating need whole columns. Nothing here imports LeRobot.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

OBSERVATION_KEYS = ("observation.state", "observation.environment_state")
LABEL_KEYS = ("mode", "pair", "branch_step")


@dataclass(frozen=True)
class Conditions:
    """Evaluation conditions: the branch point of every pair.

    Attributes:
        observation: Raw observations by LeRobot key, each (B, dim) float32.
        pair: Pair ids (B,).
    """

    observation: dict[str, np.ndarray]
    pair: np.ndarray

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
        return Conditions({key: column[frames] for key, column in self.observation.items()}, pair)

    def mode_windows(self, horizon: int) -> np.ndarray | None:
        """Positions of every pair's demonstrations after the branch, by mode: (B, K, horizon, d) in metres.

        Pairs are ordered as in :meth:`conditions`. None if a pair lacks a mode or a whole window.
        """
        position = [i for i, name in enumerate(self.action_names) if name.startswith("position.")]
        at_branch = np.flatnonzero(self.frame_index == self.labels["branch_step"])
        pairs, row = np.unique(self.labels["pair"][at_branch], return_inverse=True)
        mode = self.labels["mode"][at_branch]
        if (mode < 0).any() or not np.isin(at_branch, self.window_starts(horizon)).all():
            return None
        first = np.full((len(pairs), int(mode.max()) + 1), -1)
        first[row, mode] = at_branch
        if (first < 0).any():
            return None
        return self.action[:, position][first[..., None] + np.arange(horizon)].astype(np.float64)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the Parquet data files, in order."""
        digest = hashlib.sha256()
        for path in data_files(self.root):
            digest.update(path.read_bytes())
        return digest.hexdigest()


def read_columns(root: Path, info: dict[str, Any], wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a LeRobotDataset v3.0 as arrays (F,) or (F, width), in order of the global index.

    Args:
        root: The dataset's folder.
        info: Its ``meta/info.json``.
        wanted: Feature keys.

    Raises:
        FileNotFoundError: If the folder holds no data.
        ValueError: If a row has another width than the feature declares.
    """
    files = data_files(root)
    if not files:
        raise FileNotFoundError(f"{root} holds no Parquet data: expected data/chunk-*/file-*.parquet")
    keys = [*wanted, *({"index"} - set(wanted))]
    columns: dict[str, list[np.ndarray]] = {key: [] for key in keys}
    for path in files:
        try:
            table = pq.read_table(path, columns=keys)
        except pa.ArrowInvalid as error:
            raise ValueError(
                f"{path} is not a readable Parquet file: it may be truncated; record the dataset again"
            ) from error
        for key in keys:
            columns[key].append(_column(table.column(key), info["features"][key]["shape"], root, key))
    stacked = {key: np.concatenate(parts) for key, parts in columns.items()}
    order = np.argsort(stacked["index"], kind="stable")
    return {key: stacked[key][order] for key in wanted}


def data_files(root: Path) -> list[Path]:
    """The Parquet data files of a LeRobotDataset v3.0 folder, in order."""
    return sorted((root / "data").glob("chunk-*/file-*.parquet"))


def read_split(root: str | Path) -> SplitFrames:
    """Read the demonstrations of one split.

    Args:
        root: A LeRobotDataset v3.0 folder, as ``dualhead record`` writes it (for example ``data/ring/train``).

    Raises:
        FileNotFoundError: If the folder holds no such dataset.
        ValueError: If a feature is missing, or an action or observation is not finite.
    """
    root = Path(root)
    info_path = root / "meta" / "info.json"
    if not info_path.is_file():
        splits = [s for s in ("train", "val", "test") if (root / s / "meta" / "info.json").is_file()]
        hint = f"name one of its splits, for example {root / splits[0]}" if splits else "record one first"
        raise FileNotFoundError(f"{root} is not a LeRobotDataset (no meta/info.json): {hint}")
    info = json.loads(info_path.read_text())
    sidecar_path = root / "meta" / "dualhead.json"
    sidecar = json.loads(sidecar_path.read_text()) if sidecar_path.is_file() else {}
    wanted = ["action", "episode_index", "frame_index"]
    wanted += [key for key in (*OBSERVATION_KEYS, *LABEL_KEYS) if key in info["features"]]
    missing = [key for key in wanted[:3] if key not in info["features"]]
    if missing or not any(key in wanted for key in OBSERVATION_KEYS):
        raise ValueError(
            f"{root} lacks the features {missing or list(OBSERVATION_KEYS)}: "
            "expected a dataset written by `dualhead record`"
        )
    stacked = read_columns(root, info, wanted)
    for key in ("action", *OBSERVATION_KEYS):
        if key in stacked and not np.isfinite(stacked[key]).all():
            bad = int(np.flatnonzero(~np.isfinite(stacked[key]).all(axis=1))[0])
            raise ValueError(
                f"{root} holds a non-finite value in {key!r} at frame {bad}: expected finite numbers; "
                "record the dataset again or drop that episode"
            )
    return SplitFrames(
        root=root,
        info=info,
        sidecar=sidecar,
        observation={key: stacked[key] for key in OBSERVATION_KEYS if key in stacked},
        action=stacked["action"],
        episode_index=stacked["episode_index"],
        frame_index=stacked["frame_index"],
        labels={key: stacked[key] for key in LABEL_KEYS if key in stacked},
    )


def _column(column: Any, shape: list[int], root: Path, key: str) -> np.ndarray:
    values = column.combine_chunks()
    if hasattr(values, "flatten") and values.type.num_fields:
        flat = values.flatten().to_numpy(zero_copy_only=False)
        if len(flat) != len(values) * shape[0]:
            raise ValueError(
                f"{root} holds rows of another width than {shape[0]} in {key!r}: the dataset is damaged; "
                "record it again"
            )
        return flat.reshape(-1, shape[0])
    return values.to_numpy(zero_copy_only=False)
