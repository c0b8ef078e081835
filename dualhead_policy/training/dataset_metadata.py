"""LeRobot's metadata of a training split, opened after its statistics and episodes were held against the data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets import LeRobotDatasetMetadata

from dualhead_envs.dataset_frames import SplitFrames
from dualhead_envs.validated_json import Label, read_validated

STATISTICS = Path("meta", "stats.json")
REMEDY = "record the dataset again"
#: How far a stored mean may be from the data's, in standard deviations, and a deviation or extreme in its own size.
TOLERANCE = 0.01


def open_metadata(repo_id: str, frames: SplitFrames) -> LeRobotDatasetMetadata:
    """LeRobot's metadata of the split that ``frames`` were read from.

    Raises:
        FileNotFoundError: If a part of the metadata is missing.
        ValueError: If a part is damaged, or statistics or episodes are those of other data.
    """
    root = frames.root
    for part in (STATISTICS, Path("meta", "tasks.parquet")):
        if not (root / part).is_file():
            raise FileNotFoundError(f"{root / part} is missing: {REMEDY}")
    if not any((root / "meta" / "episodes").glob("*/*.parquet")):
        raise FileNotFoundError(f"{root / 'meta' / 'episodes'} holds no episodes: {REMEDY}")
    check_statistics(frames)
    try:
        metadata = LeRobotDatasetMetadata(repo_id, root=root)
        lengths = np.asarray(metadata.episodes["length"])
    # LeRobot passes on what pandas, pyarrow and datasets raise.
    except Exception as error:
        raise ValueError(
            f"{root / 'meta'} cannot be read as LeRobot's metadata ({type(error).__name__}): {REMEDY}"
        ) from error
    if not np.array_equal(lengths, np.bincount(frames.episode_index)):
        raise ValueError(f"{root / 'meta' / 'episodes'} describes episodes of other lengths than the data: {REMEDY}")
    return metadata


def check_statistics(frames: SplitFrames) -> None:
    """Refuse statistics that are not those of the data; normalisation would be off without anyone's notice.

    Raises:
        ValueError: In one sentence about the first quantity that differs.
    """
    path = frames.root / STATISTICS
    stored = read_validated(
        path, dict[Label, dict[Label, Any]], kind="the statistics of a LeRobotDataset", remedy=REMEDY
    )
    for key, values in {**frames.observation, "action": frames.action}.items():
        spread = values.std(axis=0, dtype=np.float64)
        floor = 1e-4 + TOLERANCE * np.abs(values).max(axis=0)
        measured = {
            "mean": (values.mean(axis=0, dtype=np.float64), TOLERANCE * spread + 1e-4),
            # A variance taken from single-precision moments is wrong by 1e-7 of the squared mean: 3e-4 m at one metre.
            "std": (spread, TOLERANCE * spread + 1e-4 + 1e-3 * np.abs(values).max(axis=0)),
            "min": (values.min(axis=0), floor),
            "max": (values.max(axis=0), floor),
        }
        for name, (own, tolerance) in measured.items():
            _check_quantity(path, f"{key}.{name}", _numbers(stored.get(key), name), own, tolerance)


def _numbers(statistics: Mapping[str, Any] | None, name: str) -> np.ndarray | None:
    try:
        return np.asarray((statistics or {})[name], dtype=np.float64).reshape(-1)
    except (KeyError, TypeError, ValueError):
        return None


def _check_quantity(path: Path, name: str, given: np.ndarray | None, own: np.ndarray, tolerance: np.ndarray) -> None:
    if given is None or given.shape != own.shape:
        raise ValueError(f"{path} has no {name} of {len(own)} numbers: {REMEDY}")
    if not (np.abs(given - own) <= tolerance).all():
        where = int(np.flatnonzero(~(np.abs(given - own) <= tolerance))[0])
        raise ValueError(
            f"{path} has {name}[{where}] = {given[where]:.6g}, the data have {own[where]:.6g}: the statistics are of "
            f"other data; {REMEDY}"
        )
