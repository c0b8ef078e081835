"""The alarm log of a run of episodes ("dualhead-alarms/1"): small, and every verdict follows from it alone."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.gate.compressed import compress, decompress, is_compressed
from dualhead_eval.monitor.aggregation import running

FORMAT = "dualhead-alarms/1"
#: Significant digits of a stored score. Ranks are those of the stored numbers, live or read back.
DIGITS = 6
#: How an infinite score is stored: JSON has no infinity.
_DIVERGED: Literal["diverged"] = "diverged"

Score = Annotated[float, Field(allow_inf_nan=False)] | Literal["diverged"]


class EpisodeEntry(BaseModel):
    """What became of one episode, and its decisions' scores by signal."""

    model_config = ConfigDict(extra="forbid")
    key: str
    success: bool
    failure: str
    stratum: str
    steps: int = Field(ge=0)
    onset: int | None
    at: list[int]
    flagged: list[bool] | None
    crossed: list[bool] | None
    scores: dict[str, list[Score]]

    @model_validator(mode="after")
    def _one_length(self) -> EpisodeEntry:
        lengths = {len(self.at), *(len(scores) for scores in self.scores.values())}
        lengths |= {len(marks) for marks in (self.flagged, self.crossed) if marks is not None}
        if len(lengths) != 1 or not self.at:
            raise ValueError(
                f"episode {self.key!r} has {sorted(lengths)} entries per decision, expected one number > 0"
            )
        return self


class AlarmDocument(BaseModel):
    """What an alarm file holds."""

    model_config = ConfigDict(extra="forbid")
    format: Literal["dualhead-alarms/1"]
    label: str
    aggregator: Literal["step", "ewma-max", "window-max", "window-mean", "mean", "max"]
    threshold: str
    alpha: float = Field(gt=0, lt=1)
    limits: dict[str, list[Score]]
    provenance: dict[str, Any]
    episodes: list[EpisodeEntry] = Field(min_length=1)

    @model_validator(mode="after")
    def _one_set_of_signals(self) -> AlarmDocument:
        wanted = set(self.limits)
        for episode in self.episodes:
            if set(episode.scores) != wanted:
                raise ValueError(f"episode {episode.key!r} scores {sorted(episode.scores)}, expected {sorted(wanted)}")
        keys = [episode.key for episode in self.episodes]
        if len(set(keys)) < len(keys):
            raise ValueError("an episode occurs twice, expected each once")
        return self


@dataclass(frozen=True, eq=False)
class AlarmLog:
    """Scores of a run of episodes under one monitor.

    Attributes:
        document: What its file holds.
    """

    document: AlarmDocument
    _running: dict[tuple[str, str], list[NDArray[np.float64]]] = field(default_factory=dict, repr=False)

    @property
    def label(self) -> str:
        """Name of the run."""
        return self.document.label

    @property
    def signals(self) -> list[str]:
        """Names of the signals."""
        return list(self.document.limits)

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether each episode succeeded ``(E,)``."""
        return np.array([episode.success for episode in self.document.episodes])

    @property
    def strata(self) -> NDArray[np.str_]:
        """Kind and level of each episode's perturbation ``(E,)``."""
        return np.array([episode.stratum for episode in self.document.episodes])

    def scores(self, signal: str) -> list[NDArray[np.float64]]:
        """Scores of every episode's decisions."""
        return [
            np.array([np.inf if s == _DIVERGED else s for s in episode.scores[signal]], dtype=np.float64)
            for episode in self.document.episodes
        ]

    def aggregates(self, signal: str, aggregator: str | None = None) -> list[NDArray[np.float64]]:
        """Running aggregates of every episode, the monitor's own by default."""
        key = signal, aggregator or self.document.aggregator
        if key not in self._running:
            self._running[key] = [running(key[1], scores) for scores in self.scores(signal)]
        return self._running[key]

    def limits_of(self, number: int, signal: str) -> NDArray[np.float64]:
        """The fitted limit at every decision of one episode."""
        table = np.array([np.inf if x == _DIVERGED else x for x in self.document.limits[signal]], dtype=np.float64)
        episode = self.document.episodes[number]
        if self.document.threshold.startswith("mondrian"):
            return table[np.array(episode.flagged, dtype=int)]
        return table[np.minimum(np.arange(len(episode.at)), len(table) - 1)]

    def exceeded(self, signal: str) -> list[NDArray[np.bool_]]:
        """Whether each decision's aggregate exceeds the fitted limit, of every episode."""
        aggregates = self.aggregates(signal)
        return [values > self.limits_of(number, signal) for number, values in enumerate(aggregates)]

    def write(self, path: str | Path) -> None:
        """Write the file, atomically; compressed if its name ends in ``.gz``, to a quarter of the size."""
        text = json.dumps(self.document.model_dump(), separators=(",", ":"), allow_nan=False) + "\n"
        write_bytes(Path(path), compress(text) if is_compressed(Path(path)) else text.encode())

    @classmethod
    def read(cls, path: str | Path) -> AlarmLog:
        """Read a file.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is damaged or of another kind.
        """
        file = Path(path)
        if not file.is_file():
            raise FileNotFoundError(f"{file} does not exist: give what `dualhead monitor report --alarms` wrote")
        if is_compressed(file):
            content = decompress(file, kind="an alarm file", remedy="write it again").encode()
        else:
            content = file.read_bytes()
        try:
            return cls(AlarmDocument.model_validate_json(content))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            field = ".".join(map(str, first["loc"])) or "the whole file"
            raise ValueError(f"{file} is no {FORMAT} ({field}: {first['msg']}): write it again") from error


def stored(value: float) -> float | Literal["diverged"]:
    """A score as an alarm log holds it."""
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else _DIVERGED


def alarm_log(table: pa.Table, document: dict[str, Any], label: str) -> AlarmLog:
    """The alarm log of a table of scores (:mod:`dualhead_eval.monitor.scores_file`)."""
    columns = table.to_pydict()
    signals = [name.removesuffix(".score") for name in table.column_names if name.endswith(".score")]
    rows: dict[str, list[int]] = {}
    for row, key in enumerate(columns["episode"]):
        rows.setdefault(key, []).append(row)

    episodes = []
    for key, own in rows.items():
        marks = {name: [columns[name][row] for row in own] for name in ("flagged", "crossed")}
        episodes.append(
            {
                "key": key,
                **{name: columns[name][own[0]] for name in ("success", "failure", "stratum", "steps", "onset")},
                "at": [columns["step"][row] for row in own],
                **{name: None if None in values else values for name, values in marks.items()},
                "scores": {name: [stored(columns[f"{name}.score"][row]) for row in own] for name in signals},
            }
        )
    return AlarmLog(
        AlarmDocument.model_validate(
            {
                "format": FORMAT,
                "label": label,
                "aggregator": document["aggregator"],
                "threshold": document["threshold"],
                "alpha": document["alpha"],
                "limits": {
                    name: [stored(np.inf if limit is None else limit) for limit in document["limits"][name]]
                    for name in signals
                },
                "provenance": document.get("provenance", {}),
                "episodes": episodes,
            }
        )
    )
