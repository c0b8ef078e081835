"""What is kept of one run: alarms of its sampled pairs, counted per test pair of demonstrations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from dualhead_envs.validated_json import Schema, read_validated
from dualhead_eval.atomic_text import write_text

Counts = list[Annotated[int, Field(ge=0)]]
#: Readings of a run: A's heads with sides told from the paths; K's heads from two draws, with sides known by their
#: tokens and told from the paths; K's heads from one draw.
ReadingName = Literal["A", "K apart", "K apart, sides from paths", "K together"]


class ReadingTally(Schema):
    """Alarms of one reading; every list has an entry per test pair of demonstrations.

    Attributes:
        threshold_mm: The residual above which a decision is an alarm.
        same, same_alarms: Flagged sampled pairs on one side, and alarms among them.
        same_mm: Sum of their residuals.
        cross, cross_alarms: Flagged sampled pairs on two sides, and alarms among them.
        other, other_alarms: Sampled pairs at decisions that are not flagged, and alarms among them.
    """

    threshold_mm: Annotated[float, Field(ge=0)]
    same: Counts
    same_alarms: Counts
    same_mm: list[Annotated[float, Field(ge=0)]]
    cross: Counts
    cross_alarms: Counts
    other: Counts
    other_alarms: Counts


class RunTally(Schema):
    """One run: side step, arm, training seed, the demonstrations' separation per test pair, its readings."""

    format: Literal["dualhead-monitor-converse-run/1"]
    amplitude_mm: Annotated[int, Field(ge=0)]
    arm: Literal["A", "K"]
    seed: Annotated[int, Field(ge=0)]
    separation_mm: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]
    readings: Annotated[dict[ReadingName, ReadingTally], Field(min_length=1)]
    provenance: dict[str, Any]

    @model_validator(mode="after")
    def _of_one_length(self) -> RunTally:
        for name, reading in self.readings.items():
            lists = {field: value for field, value in reading.model_dump().items() if isinstance(value, list)}
            if wrong := [field for field, value in lists.items() if len(value) != len(self.separation_mm)]:
                raise ValueError(f"has {wrong[0]} of {name!r} of another length than separation_mm")
            for part in ("same", "cross", "other"):
                if any(a > n for a, n in zip(lists[f"{part}_alarms"], lists[part], strict=True)):
                    raise ValueError(f"has more alarms than pairs in {part} of {name!r}")
        return self

    def write(self, path: Path) -> None:
        """Write one JSON file, atomically."""
        write_text(path, json.dumps(self.model_dump(mode="json"), separators=(",", ":")) + "\n")


def read_tally(path: Path) -> RunTally:
    """Read a run.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is damaged or of another kind.
    """
    return read_validated(
        path, RunTally, kind="a scored run of the converse", remedy="delete it, and repeat the study's command"
    )
