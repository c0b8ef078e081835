"""The columns of a LeRobotDataset v3.0, straight from its Parquet files, checked against its ``info.json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field

from dualhead_envs.validated_json import Label, OpenSchema, read_validated

#: Where LeRobot describes a dataset's features.
INFO = Path("meta", "info.json")
REMEDY = "record the dataset again"
#: Kinds of NumPy numbers by the dtype of a feature.
KINDS = {"float32": "f", "float64": "f", "int32": "i", "int64": "i", "bool": "b"}


class Feature(OpenSchema):
    """A feature of a LeRobotDataset, as far as columns of numbers need it."""

    dtype: Label
    shape: Annotated[list[Annotated[int, Field(ge=0, le=10**6)]], Field(max_length=8)]
    names: Any = None


class DatasetInfo(OpenSchema):
    """``meta/info.json`` of a LeRobotDataset."""

    codebase_version: Literal["v3.0"]
    fps: Annotated[float, Field(gt=0)]
    total_episodes: Annotated[int, Field(ge=1)]
    total_frames: Annotated[int, Field(ge=1)]
    features: dict[Label, Feature]


def read_info(root: Path) -> dict[str, Any]:
    """The checked content of a dataset's ``meta/info.json``.

    Raises:
        FileNotFoundError: If the folder holds no dataset.
        ValueError: If the file is damaged or of another version.
    """
    if not (root / INFO).is_file():
        splits = [split for split in ("train", "val", "test") if (root / split / INFO).is_file()]
        hint = f"name one of its splits, for example {root / splits[0]}" if splits else "record one first"
        raise FileNotFoundError(f"{root} is not a LeRobotDataset (no meta/info.json): {hint}")
    kind = "the description of a LeRobotDataset v3.0"
    return read_validated(root / INFO, DatasetInfo, kind=kind, remedy=REMEDY).model_dump()


def data_files(root: Path) -> list[Path]:
    """The Parquet data files of a LeRobotDataset v3.0 folder, in order."""
    return sorted((root / "data").glob("chunk-*/file-*.parquet"))


def read_columns(root: Path, info: dict[str, Any], wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a LeRobotDataset v3.0 as arrays (F,) or (F, width), in order of the global index.

    Args:
        root: The dataset's folder.
        info: Its ``meta/info.json``.
        wanted: Feature keys.

    Raises:
        FileNotFoundError: If the folder holds no data.
        ValueError: If a file is damaged, a feature is missing, of another type or width than declared, or the frames
            are not those that ``info.json`` counts, each once.
    """
    files = data_files(root)
    if not files:
        raise FileNotFoundError(f"{root} holds no Parquet data, expected data/chunk-*/file-*.parquet: {REMEDY}")
    keys = [*wanted, *({"index"} - set(wanted))]
    unknown = [key for key in keys if key not in info["features"]]
    if unknown:
        raise ValueError(f"{root / INFO} has no feature {unknown[0]!r}, expected {list(keys)}: {REMEDY}")
    columns: dict[str, list[np.ndarray]] = {key: [] for key in keys}
    for path in files:
        table = _read_table(path, keys)
        for key in keys:
            columns[key].append(_column(table.column(key), info["features"][key], path, key))
    stacked = {key: np.concatenate(parts) for key, parts in columns.items()}
    order = np.argsort(stacked["index"], kind="stable")
    frames = info.get("total_frames", len(order))
    if len(order) != frames or not np.array_equal(stacked["index"][order], np.arange(frames)):
        raise ValueError(
            f"{root} holds {len(order)} frames, expected the {frames} of its meta/info.json with the indices 0 to "
            f"{frames - 1}, each once: {REMEDY}"
        )
    return {key: stacked[key][order] for key in wanted}


def _read_table(path: Path, keys: Sequence[str]) -> Any:
    try:
        there = pq.read_schema(path).names
        missing = [key for key in keys if key not in there]
        table = None if missing else pq.read_table(path, columns=list(keys), page_checksum_verification=True)
    # Arrow raises its own errors, and OSError for what its decompressors trip over.
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ValueError(f"{path} is not a readable Parquet file: it may be truncated; {REMEDY}") from error
    if missing:
        raise ValueError(f"{path} lacks the column {missing[0]!r}, which meta/info.json declares: {REMEDY}")
    return table


def _column(column: Any, feature: dict[str, Any], path: Path, key: str) -> np.ndarray:
    values = column.combine_chunks()
    if isinstance(values, pa.ExtensionArray):
        # What `datasets` makes of lists of lists once it is imported.
        values = values.storage
    width = math.prod(feature["shape"])
    if values.null_count:
        raise ValueError(f"{path} holds empty values in {key!r}, expected numbers: {REMEDY}")
    if not pa.types.is_list(values.type) and not pa.types.is_fixed_size_list(values.type):
        if width != 1:
            raise ValueError(f"{path} holds single numbers in {key!r}, expected rows of {width}: {REMEDY}")
        return _numbers(values, feature, path, key)
    inner = values
    # A feature of several axes is stored as lists of lists.
    while pa.types.is_list(inner.type) or pa.types.is_fixed_size_list(inner.type):
        if inner.null_count or len(set(inner.value_lengths().to_pylist())) > 1:
            raise ValueError(f"{path} holds rows of different widths in {key!r}, expected {width} numbers: {REMEDY}")
        inner = inner.flatten()
    flat = _numbers(inner, feature, path, key)
    if len(flat) != len(values) * width:
        raise ValueError(f"{path} holds rows of another width than {width} in {key!r}: {REMEDY}")
    return flat.reshape(-1, width)


def _numbers(values: Any, feature: dict[str, Any], path: Path, key: str) -> np.ndarray:
    kind = KINDS.get(feature["dtype"])
    numbers = None
    if kind is not None and not pa.types.is_nested(values.type) and not values.null_count:
        numbers = values.to_numpy(zero_copy_only=False)
    if numbers is None or numbers.dtype.kind != kind:
        raise ValueError(f"{path} holds {values.type} in {key!r}, expected {feature['dtype']}: {REMEDY}")
    return numbers
