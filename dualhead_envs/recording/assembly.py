"""Bulk assembly of a LeRobotDataset v3.0 from finished episodes.

The files are those that LeRobot 0.6 would have written frame by frame (data, episodes with their statistics,
tasks, info, aggregated statistics), written at once and renamed into place.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dualhead_envs.atomic_files import sync_folder, sync_tree, write_atomically
from dualhead_envs.layout import Layout
from dualhead_envs.recording.episode import Episode
from dualhead_envs.recording.statistics import Statistics, aggregate, episode_statistics

FORMAT = "dualhead-dataset/1"

_FILE_MB = 100  # LeRobot's own limit
_FILE_BYTES = _FILE_MB * 1024**2
_FILES_A_CHUNK = 1000
_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_BOOKKEEPING = {
    "timestamp": {"dtype": "float32", "shape": (1,), "names": None},
    "frame_index": {"dtype": "int64", "shape": (1,), "names": None},
    "episode_index": {"dtype": "int64", "shape": (1,), "names": None},
    "index": {"dtype": "int64", "shape": (1,), "names": None},
    "task_index": {"dtype": "int64", "shape": (1,), "names": None},
}


def assemble(
    shards: Iterable[Sequence[Episode]], target: Path, layout: Layout, info: Mapping[str, Any], *, task: str
) -> Path:
    """Write the episodes of ``shards``, in order, as the LeRobotDataset ``target``.

    Args:
        shards: Lists of episodes; their order is the order of the dataset.
        target: Folder of the dataset; must not exist.
        layout: Names and widths of observations and actions, and the control rate.
        info: Content of ``meta/dualhead.json`` beside the format and the layout's name.
        task: The task in a sentence, as LeRobot's ``task``.

    Returns:
        ``target``.

    Raises:
        FileExistsError: If ``target`` exists.
        ValueError: If there is no episode, or one does not fit the layout.
    """
    target = Path(target)
    if target.exists():
        raise FileExistsError(f"{target} already exists: choose another output folder, or delete it first")
    episodes = list(chain.from_iterable(shards))
    if not episodes:
        raise ValueError(f"there is no episode to write to {target}: record at least one")
    features = layout.dataset_features() | _BOOKKEEPING
    frames = _frame_columns(episodes, layout.fps)
    for key, feature in features.items():
        width = frames[key].shape[1] if frames[key].ndim == 2 else 1
        if (width,) != feature["shape"]:
            raise ValueError(
                f"episodes have {key} of width {width}, layout {layout.name} expects {feature['shape'][0]}: "
                "record with the environment of this layout"
            )
    lengths = np.array([len(episode) for episode in episodes])
    statistics = _statistics_by_feature(frames, lengths, layout.fps)

    folder = target.with_name(f".{target.name}.partial")
    shutil.rmtree(folder, ignore_errors=True)
    data_files = _write_files(folder / "data", _data_table(frames, features), lengths)
    _write_files(
        folder / "meta" / "episodes",
        _episode_table(lengths, data_files, statistics, task),
        np.ones(len(lengths), dtype=np.int64),
        "meta/episodes",
    )
    _write_tasks(folder / "meta" / "tasks.parquet", task)
    _write_json(folder / "meta" / "info.json", _dataset_info(features, layout.fps, lengths))
    aggregated = {
        key: {name: values.tolist() for name, values in aggregate(feature_statistics).items()}
        for key, feature_statistics in statistics.items()
    }
    _write_json(folder / "meta" / "stats.json", aggregated)
    _write_json(folder / "meta" / "dualhead.json", {"format": FORMAT, "layout": layout.name, **info})
    sync_tree(folder)
    folder.rename(target)
    sync_folder(target.parent)
    return target


def _frame_columns(episodes: Sequence[Episode], fps: int) -> dict[str, np.ndarray]:
    """The dataset's columns: vectors (frames, width) and scalars (frames,)."""
    lengths = np.array([len(episode) for episode in episodes])
    starts = np.repeat(np.cumsum(lengths) - lengths, lengths)
    index = np.arange(lengths.sum())
    columns = {
        "observation.state": np.concatenate([episode.observation_state for episode in episodes]),
        "observation.environment_state": np.concatenate([episode.environment_state for episode in episodes]),
        "action": np.concatenate([episode.action for episode in episodes]),
    }
    columns = {key: values.astype(np.float32, copy=False) for key, values in columns.items()}
    for key in ("mode", "pair", "branch_step"):
        values = np.array([getattr(episode, key) for episode in episodes], dtype=np.int64)
        columns[key] = np.repeat(values, lengths)
    columns["timestamp"] = ((index - starts) / fps).astype(np.float32)
    columns["frame_index"] = index - starts
    columns["episode_index"] = np.repeat(np.arange(len(episodes)), lengths)
    columns["index"] = index
    columns["task_index"] = np.zeros_like(index)
    return columns


def _statistics_by_feature(frames: Mapping[str, np.ndarray], lengths: np.ndarray, fps: int) -> dict[str, Statistics]:
    """Each feature's statistics of every episode, computed for all episodes of one length together."""
    starts = np.cumsum(lengths) - lengths
    # LeRobot sees timestamps before they are rounded to float32.
    frames = {**frames, "timestamp": frames["frame_index"] / fps}
    merged: dict[str, Statistics] = {}
    for length in np.unique(lengths):
        which = np.flatnonzero(lengths == length)
        rows = starts[which, None] + np.arange(length)
        for key, values in frames.items():
            part = episode_statistics(values.reshape(len(values), -1)[rows])
            for name, numbers in part.items():
                if name not in merged.setdefault(key, {}):
                    merged[key][name] = np.empty((len(lengths), numbers.shape[1]), numbers.dtype)
                merged[key][name][which] = numbers
    return merged


def _data_table(frames: Mapping[str, np.ndarray], features: Mapping[str, dict]) -> pa.Table:
    return pa.table(
        {
            key: pa.FixedSizeListArray.from_arrays(pa.array(frames[key].ravel()), frames[key].shape[1])
            if frames[key].ndim == 2
            else pa.array(frames[key])
            for key in features
        }
    )


def _episode_table(
    lengths: np.ndarray, data_files: np.ndarray, statistics: Mapping[str, Statistics], task: str
) -> pa.Table:
    ends = np.cumsum(lengths)
    columns = {
        "episode_index": pa.array(np.arange(len(lengths))),
        "tasks": pa.array([[task]] * len(lengths)),
        "length": pa.array(lengths),
        "data/chunk_index": pa.array(data_files // _FILES_A_CHUNK),
        "data/file_index": pa.array(data_files % _FILES_A_CHUNK),
        "dataset_from_index": pa.array(ends - lengths),
        "dataset_to_index": pa.array(ends),
    }
    for key, feature_statistics in statistics.items():
        for name, values in feature_statistics.items():
            numbers = values if name == "count" else values.astype(np.float64)
            offsets = np.arange(0, numbers.size + 1, numbers.shape[1], dtype=np.int32)
            columns[f"stats/{key}/{name}"] = pa.ListArray.from_arrays(offsets, numbers.ravel())
    return pa.table(columns)


def _write_files(folder: Path, table: pa.Table, lengths: np.ndarray, index_columns: str | None = None) -> np.ndarray:
    """Write ``table`` in files below LeRobot's size limit that end where an episode ends.

    Args:
        folder: The folder of the chunks.
        table: All rows.
        lengths: Rows of each episode (n,).
        index_columns: Prefix of two columns that say in which chunk and file a row is, if there are any.

    Returns:
        The running number of the file that holds each episode (n,).
    """
    ends = np.cumsum(lengths)
    rows_a_file = max(int(_FILE_BYTES / (table.nbytes / len(table))), int(lengths.max()))
    numbers = (ends - 1) // rows_a_file
    for number in np.unique(numbers):
        which = np.flatnonzero(numbers == number)
        part = table.slice(ends[which[0]] - lengths[which[0]], lengths[which].sum())
        chunk, file = divmod(int(number), _FILES_A_CHUNK)
        if index_columns is not None:
            for name, value in (("chunk_index", chunk), ("file_index", file)):
                part = part.append_column(f"{index_columns}/{name}", pa.array(np.full(len(part), value)))
        path = folder / _PATH.format(chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(part, path, compression="snappy", use_dictionary=False, write_page_checksum=True)
    return numbers


def _write_tasks(path: Path, task: str) -> None:
    import pandas as pd  # LeRobot reads the index from pandas' metadata

    pd.DataFrame({"task_index": [0]}, index=pd.Index([task], name="task")).to_parquet(path)


def _dataset_info(features: Mapping[str, dict], fps: int, lengths: np.ndarray) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "fps": fps,
        "features": {key: feature | {"shape": list(feature["shape"])} for key, feature in features.items()},
        "total_episodes": len(lengths),
        "total_frames": int(lengths.sum()),
        "total_tasks": 1,
        "chunks_size": _FILES_A_CHUNK,
        "data_files_size_in_mb": _FILE_MB,
        "video_files_size_in_mb": 200,
        "data_path": f"data/{_PATH}",
        "video_path": None,
        "robot_type": None,
        "splits": {"train": f"0:{len(lengths)}"},
    }


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(content, indent=4) + "\n")
