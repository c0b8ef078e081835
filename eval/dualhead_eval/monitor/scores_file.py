"""``*.scores.parquet``: a row per decision, what every signal said and what is known of the episode."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.monitor.decision import Episode
from dualhead_eval.monitor.monitor import Monitor

FORMAT = "dualhead-scores/1"
_METADATA = b"dualhead"
#: Columns beside those of the signals, with their types.
EPISODE_COLUMNS = {
    "episode": pa.string(),
    "success": pa.bool_(),
    "failure": pa.string(),
    "stratum": pa.string(),
    "steps": pa.int64(),
    "onset": pa.int64(),
    "decision": pa.int64(),
    "step": pa.int64(),
    "flagged": pa.bool_(),
    "crossed": pa.bool_(),
}


def score_episodes(monitor: Monitor, episodes: Iterable[Episode], progress: Any = None) -> pa.Table:
    """Read every episode with the monitor: a row per decision, columns ``NAME.score``, ``.aggregate``, ``.alarm``."""
    columns: dict[str, list] = {name: [] for name in EPISODE_COLUMNS}
    for name in monitor.names:
        columns |= {f"{name}.{kind}": [] for kind in ("score", "aggregate", "threshold", "alarm")}
    for episode in episodes:
        for index, (decision, reading) in enumerate(zip(episode.decisions, monitor.read(episode), strict=True)):
            row = {
                "episode": episode.key,
                "success": episode.success,
                "failure": episode.failure,
                "stratum": episode.stratum,
                "steps": episode.steps,
                "onset": episode.onset,
                "decision": index,
                "step": decision.step,
                "flagged": decision.flagged,
                "crossed": decision.crossed,
            }
            for name, said in reading.by_signal.items():
                row |= {
                    f"{name}.score": said.score,
                    f"{name}.aggregate": said.aggregate,
                    f"{name}.threshold": said.threshold,
                    f"{name}.alarm": said.alarm,
                }
            for name, value in row.items():
                columns[name].append(value)
        if progress is not None:
            progress(1)
    types = EPISODE_COLUMNS | {
        name: pa.bool_() if name.endswith(".alarm") else pa.float64() for name in columns if "." in name
    }
    return pa.table({name: pa.array(values, types[name]) for name, values in columns.items()})


def write_scores(table: pa.Table, path: str | Path, provenance: dict[str, Any]) -> None:
    """Write scores with their provenance, atomically."""
    document = json.dumps({"format": FORMAT, **provenance})
    content = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({_METADATA: document.encode()}), content)
    write_bytes(Path(path), content.getvalue())


def read_scores(path: str | Path) -> tuple[pa.Table, dict[str, Any]]:
    """Read scores and their provenance.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is of another kind.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"{file} does not exist: give what `dualhead monitor score --output` wrote")
    try:
        table = pq.read_table(file)
    except pa.ArrowInvalid as error:
        raise ValueError(f"{file} is not a readable Parquet file ({error}): score the rollouts again") from error
    try:
        document = json.loads((table.schema.metadata or {}).get(_METADATA, b"{}"))
    except json.JSONDecodeError:
        document = {}
    missing = [name for name in EPISODE_COLUMNS if name not in table.column_names]
    if missing or not isinstance(document, dict) or document.get("format") != FORMAT or not table.num_rows:
        raise ValueError(
            f"{file} holds no scores of a monitor (lacks {missing or FORMAT}): give what `dualhead monitor score` wrote"
        )
    return table, document
