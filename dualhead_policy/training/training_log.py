"""``training_log.jsonl``: mean losses of a run, and what was measured beside them."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.validated_json import parse_json, validated

LOG_FILE = "training_log.jsonl"
#: One line summarises this many steps at most.
LOG_EVERY = 200


class LogLine(BaseModel):
    """One line of the log: means over the steps since the line before.

    Attributes:
        step: Last step of the mean.
        loss: Total loss.
        flow_loss: The flow-matching losses' share of it; None in logs of before it was written.
        steps_per_second: Speed.
    """

    # What is measured beside the losses differs from policy to policy.
    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False, frozen=True)

    step: Annotated[int, Field(ge=1)]
    loss: float
    flow_loss: float | None = None
    steps_per_second: Annotated[float, Field(ge=0)] = 0.0


def read_training_log(path: Path) -> list[LogLine]:
    """The whole lines of a log, in order; none if there is no log.

    Raises:
        ValueError: If a line is damaged, or the steps do not increase.
    """
    lines = []
    remedy = "train again, or move the log away"
    for number, text in enumerate(_whole_lines(path), start=1):
        source = f"{path}, line {number},"
        document = parse_json(text, source=source, kind="a line of a training log", remedy=remedy)
        lines.append(validated(document, LogLine, source=source, remedy=remedy))
        if len(lines) > 1 and lines[-1].step <= lines[-2].step:
            raise ValueError(
                f"{source} is of step {lines[-1].step} after step {lines[-2].step}, expected a later one: {remedy}"
            )
    return lines


class TrainingLog:
    """Mean losses, one JSON line per :data:`LOG_EVERY` steps.

    A resumed run drops what it will do again, and the torn line that a kill or a full disk may have left at the end.

    Args:
        path: The file.
        step: The step from which the run goes on.
    """

    def __init__(self, path: Path, step: int):
        self.path = path
        kept = [
            text for text, line in zip(_whole_lines(path), read_training_log(path), strict=True) if line.step <= step
        ]
        write_atomically(path, "".join(line + "\n" for line in kept))
        self._losses: list[tuple[float, float]] = []
        self._measured: dict[str, dict[str, float]] = {}
        self._since = time.perf_counter()

    def measure(self, measured: dict[str, dict[str, float]]) -> None:
        """Keep what was measured beside the loss for the next line."""
        self._measured = measured

    def add(self, step: int, loss: float, flow: float) -> None:
        """Count the loss of ``step``, and the flow-matching losses' share of it."""
        self._losses.append((loss, flow))
        if len(self._losses) >= LOG_EVERY:
            self.flush(step)

    def flush(self, step: int) -> None:
        """Write the mean of the steps since the last line."""
        if not self._losses:
            return
        seconds = time.perf_counter() - self._since
        line: dict[str, Any] = {
            "step": step,
            "loss": sum(loss for loss, _ in self._losses) / len(self._losses),
            "flow_loss": sum(flow for _, flow in self._losses) / len(self._losses),
            "steps_per_second": len(self._losses) / seconds,
        }
        line |= self._measured
        length = self.path.stat().st_size
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError:
            os.truncate(self.path, length)  # what a full disk still took of the line
            raise
        self._losses, self._measured, self._since = [], {}, time.perf_counter()


def _whole_lines(path: Path) -> list[str]:
    if not path.is_file():
        return []
    try:
        return [line for line in path.read_text(encoding="utf-8").split("\n")[:-1] if line]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not a training log (not UTF-8): train again, or move it away") from error
