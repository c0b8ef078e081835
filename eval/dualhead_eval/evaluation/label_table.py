"""A table of mode labels that anyone wrote, CSV or Parquet, and its counts: a gate without a policy or a partition.

Every row is one sample pair: the condition under which both heads (or draws, or policies) were sampled, and the mode of
each. Columns:

============ ==================================================================================================
``condition`` number or name of the condition; pairs of one condition are counted together
``label_a``  mode of the first head, 0..K-1, or -1 where it is invalid
``label_b``  mode of the second head
``episode``  optional: conditions of one episode are resampled together, and numbered within it
``sample``   optional: number or name of the pair within its condition, so that a row given twice is noticed
============ ==================================================================================================
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from dualhead_envs.validated_json import MAX_BYTES, shown
from dualhead_eval.evaluation.labelled_pairs import installed_versions
from dualhead_eval.gate.gate import LABEL_TABLE, Gate

LABELS = ("label_a", "label_b")
REQUIRED = ("condition", *LABELS)
OPTIONAL = ("episode", "sample")
#: Most modes that labels may name.
MAX_MODES = 1000
#: Most cells of all joint tables together.
MAX_CELLS = 50_000_000


@dataclass(frozen=True)
class LabelTable:
    """The sample pairs of a table, one a row.

    Attributes:
        labels: Modes of both heads (rows, 2) int64, -1 invalid.
        condition: Row's condition (rows,), counted from 0 in the order of (episode, condition).
        episode: Episode of every condition (conditions,), counted from 0; without episodes each is its own.
        source: Where it was read.
        fingerprint: SHA-256 of the file.
    """

    labels: np.ndarray
    condition: np.ndarray
    episode: np.ndarray
    source: str
    fingerprint: str


def read_label_table(path: str | Path) -> LabelTable:
    """Read and check a table of labels.

    Args:
        path: A ``.csv`` or ``.parquet`` file with the columns above.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: In one sentence about the first thing that is wrong with it.
    """
    path = Path(path)
    table = _read(path)
    _check_columns(path, table.column_names)
    if table.num_rows == 0:
        raise ValueError(f"{path} holds no rows, expected one per sample pair: write the labels again")
    columns = {name: table.column(name).combine_chunks() for name in table.column_names}
    for name, column in columns.items():
        if column.null_count:
            row = int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
            raise ValueError(
                f"{path} has no {name} in row {row + 1}, expected a value in every row: write -1 for the label of an "
                "invalid sample"
            )
    labels = np.column_stack([_labels(path, name, columns[name]) for name in LABELS])
    keys = {name: _ranks(path, name, columns[name]) for name in ("episode", "condition", "sample") if name in columns}
    named = np.column_stack([keys[name] for name in ("episode", "condition") if name in keys])
    conditions, condition = np.unique(named, axis=0, return_inverse=True)
    condition = condition.reshape(-1)
    if "sample" in keys:
        _check_samples(path, np.column_stack([condition, keys["sample"]]))
    episode = conditions[:, 0] if "episode" in keys else np.arange(len(conditions))
    return LabelTable(labels, condition, episode, str(path), hashlib.sha256(path.read_bytes()).hexdigest())


def label_gate(table: LabelTable, n_modes: int | None = None, *, label: str) -> Gate:
    """Count a table of labels into a gate.

    Args:
        table: The sample pairs.
        n_modes: Number of modes K; by default one more than the largest label, at least 2.
        label: Name of the run in tables.

    Raises:
        ValueError: If a label lies beyond the modes, or the counts would not fit into memory.
    """
    largest = int(table.labels.max())
    modes = max(2, largest + 1) if n_modes is None else n_modes
    if not 2 <= modes <= MAX_MODES:
        raise ValueError(f"{table.source} would have {modes} modes, expected 2 to {MAX_MODES}: number modes from 0")
    if largest >= modes:
        row = int(np.flatnonzero((table.labels >= modes).any(axis=1))[0])
        raise ValueError(
            f"{table.source} has the label {largest} (row {row + 1} is the first beyond {modes - 1}), expected -1 to "
            f"{modes - 1}: number modes from 0, or give a larger --modes"
        )
    side, count = modes + 1, len(table.episode)
    if count * side**2 > MAX_CELLS:
        raise ValueError(
            f"{table.source} has {count} conditions of {modes} modes, expected at most {MAX_CELLS} cells in their "
            "tables: number modes without gaps, or split the table"
        )
    # Conditions may have different numbers of pairs, unlike samples drawn by a protocol.
    at = np.where(table.labels < 0, modes, table.labels)
    cell = (table.condition * side + at[:, 0]) * side + at[:, 1]
    counts = np.bincount(cell, minlength=count * side**2).reshape(1, 1, count, side, side)
    return Gate(
        heads=("a", "b"),
        n_modes=modes,
        # Nothing was thresholded or integrated here: one operating point, which stands for the labels as they are.
        taus=[0.0],
        nfes=[1],
        reference_tau=0.0,
        reference_nfe=1,
        counts=counts.astype(np.int64),
        conditions=np.arange(count, dtype=np.float64)[:, None],
        pair_ids=table.episode,
        provenance={
            "label": label,
            "method": LABEL_TABLE,
            "partition": {"name": "labels", "n_modes": modes, "tau": 0.0},
            "table": {
                "name": Path(table.source).name,
                "sha256": table.fingerprint,
                "rows": len(table.labels),
                "n_modes": "inferred" if n_modes is None else "given",
            },
            "versions": installed_versions(),
        },
    )


def _read(path: Path) -> Any:
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ValueError(f"{path} is named neither .csv nor .parquet, expected a table of labels: write one of these")
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist, expected a CSV or Parquet table of labels: check the path")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes, expected at most {MAX_BYTES}: split the table")
    try:
        if path.suffix.lower() == ".csv":
            table = pyarrow.csv.read_csv(path)
        else:
            # One file, never a folder of them.
            table = pq.ParquetFile(path, page_checksum_verification=True).read()
        table.validate(full=True)
        return table.rename_columns([str(name) for name in table.column_names])
    # Arrow raises its own errors, and OSError for what its decompressors trip over.
    except (pa.ArrowException, OSError, ValueError) as error:
        kind = path.suffix.lower().removeprefix(".")
        why = " ".join(str(error).split())[:160]
        raise ValueError(f"{path} is not a readable {kind} table ({why}): write it again") from error


def _check_columns(path: Path, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    missing = [name for name in REQUIRED if name not in names]
    unknown = [name for name in names if name not in (*REQUIRED, *OPTIONAL)]
    wanted = f"expected {', '.join(REQUIRED)} and, if known, {', '.join(OPTIONAL)}"
    if twice:
        raise ValueError(f"{path} has the column {shown(twice[0])} twice, {wanted}: rename or drop one")
    if missing:
        raise ValueError(f"{path} has the columns {shown(names, 120)} and lacks {missing[0]!r}, {wanted}: rename them")
    if unknown:
        raise ValueError(f"{path} has a column {shown(unknown[0])}, {wanted}: drop it")


def _labels(path: Path, name: str, column: Any) -> np.ndarray:
    """A column of labels as int64; whole numbers stored as floats are taken, as data frames often hold them."""
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise ValueError(f"{path} holds {kind} in {name}, expected whole numbers from -1: label samples by mode number")
    values = column.to_numpy(zero_copy_only=False)
    # NaN and infinity compare as false.
    whole = (values >= -1) & (values < 2**31)
    whole &= np.equal(np.floor(values), values, where=whole, out=np.zeros(len(values), dtype=bool))
    if not whole.all():
        row = int(np.flatnonzero(~whole)[0])
        raise ValueError(
            f"{path} has {name} = {values[row]} in row {row + 1}, expected a whole number from -1 (invalid): label "
            "samples by mode number"
        )
    return values.astype(np.int64)


def _ranks(path: Path, name: str, column: Any) -> np.ndarray:
    """A column of numbers or names as ranks from 0."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.dictionary_decode(), kind.value_type
    if not (pa.types.is_integer(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise ValueError(f"{path} holds {kind} in {name}, expected whole numbers or names: number them from 0")
    return np.unique(column.to_numpy(zero_copy_only=False), return_inverse=True)[1].reshape(-1)


def _check_samples(path: Path, keys: np.ndarray) -> None:
    """Refuse a pair that is there twice."""
    _, first, number = np.unique(keys, axis=0, return_index=True, return_counts=True)
    if (number > 1).any():
        row = int(first[number > 1].min())
        raise ValueError(
            f"{path} holds the sample of row {row + 1} more than once, expected every sample of a condition once: drop "
            "the copies"
        )
