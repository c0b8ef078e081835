"""A fitted monitor on disk: ``monitor.json`` ("dualhead-monitor/1") and ``monitor.safetensors``, nothing pickled."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from dualhead_envs.recording.staging import publish, staging_folder
from dualhead_eval.monitor.monitor import Monitor
from dualhead_eval.monitor.signals.registry import make_signal

FORMAT = "dualhead-monitor/1"
DOCUMENT, TENSORS = "monitor.json", "monitor.safetensors"


class SignalEntry(BaseModel):
    """One signal: its name, the arguments of its constructor, what its threshold guarantees."""

    model_config = ConfigDict(extra="forbid", strict=True)
    name: str
    options: dict[str, str | int | float]
    guarantee: str


class MonitorDocument(BaseModel):
    """What ``monitor.json`` holds."""

    model_config = ConfigDict(extra="forbid", strict=True)
    format: Literal["dualhead-monitor/1"]
    version: str
    layout: str
    horizon: int = Field(gt=0)
    observation: int = Field(gt=0)
    samples: int = Field(gt=0)
    aggregator: str
    threshold: str
    alpha: float = Field(gt=0, lt=1)
    signals: list[SignalEntry] = Field(min_length=1)
    calibration: list[str]
    provenance: dict[str, Any]


def save_monitor(
    monitor: Monitor,
    folder: str | Path,
    *,
    layout: dict[str, Any],
    samples: int,
    provenance: dict[str, Any] | None = None,
) -> None:
    """Write a fitted monitor, aside and then renamed.

    Args:
        monitor: The monitor.
        folder: Where; must not hold anything.
        layout: ``layout``, ``horizon`` and ``observation`` of what it was fitted on.
        samples: Pairs per decision that it was fitted on.
        provenance: Where its calibration comes from.

    Raises:
        FileExistsError: If the folder holds anything.
        ValueError: If the monitor has not been fitted.
    """
    if monitor.alpha is None:
        raise ValueError("the monitor has no threshold yet, expected a call of fit before it is saved")
    entries: list[SignalEntry] = []
    tensors: dict[str, np.ndarray] = {}
    for channel in monitor.channels:
        signal, threshold = channel.signal, channel.threshold
        entries.append(SignalEntry(name=signal.name, options=signal.options(), guarantee=threshold.guarantee))
        for kind, arrays in (("signal", signal.learned()), ("threshold", threshold.learned())):
            tensors |= {f"{signal.name}/{kind}/{name}": np.ascontiguousarray(a) for name, a in arrays.items()}
    document = MonitorDocument(
        format="dualhead-monitor/1",
        version=version("lerobot_policy_dualhead"),
        **layout,
        samples=samples,
        aggregator=monitor.aggregator_name,
        threshold=monitor.threshold_name,
        alpha=monitor.alpha,
        signals=entries,
        calibration=list(monitor.calibration),
        provenance=provenance or {},
    )
    root = Path(folder)
    with staging_folder(root) as staging:
        made = staging / "monitor"
        made.mkdir()
        (made / TENSORS).write_bytes(save(tensors))
        (made / DOCUMENT).write_text(json.dumps(document.model_dump(), indent=1), encoding="utf-8")
        publish(made, root)


def load_monitor(folder: str | Path) -> tuple[Monitor, MonitorDocument]:
    """Read a fitted monitor.

    Raises:
        FileNotFoundError: If the folder lacks one of its two files.
        ValueError: If a file is damaged, of another version, or the two do not fit.
    """
    root = Path(folder)
    for name in (DOCUMENT, TENSORS):
        if not (root / name).is_file():
            raise FileNotFoundError(f"{root / name} does not exist: give what `dualhead monitor fit --output` wrote")
    path = root / DOCUMENT
    try:
        document = MonitorDocument.model_validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "the whole file"
        raise ValueError(f"{path} is no {FORMAT} ({field}: {first['msg']}): fit the monitor again") from error
    try:
        tensors = load((root / TENSORS).read_bytes())
    except SafetensorError as error:
        raise ValueError(f"{root / TENSORS} is not readable ({error}): fit the monitor again") from error
    signals = [make_signal(entry.name, **entry.options) for entry in document.signals]
    monitor = Monitor(signals, document.aggregator, document.threshold)
    for channel, entry in zip(monitor.channels, document.signals, strict=True):
        try:
            for kind, owner in (("signal", channel.signal), ("threshold", channel.threshold)):
                prefix = f"{entry.name}/{kind}/"
                arrays = {name.removeprefix(prefix): a for name, a in tensors.items() if name.startswith(prefix)}
                if arrays or kind == "threshold" or channel.signal.learns:
                    owner.restore(arrays)
        except (KeyError, IndexError, ValueError) as error:
            raise ValueError(
                f"{root / TENSORS} does not hold what {entry.name!r} learned ({error}): fit the monitor again"
            ) from error
        channel.threshold.guarantee = entry.guarantee
    monitor.alpha, monitor.calibration = document.alpha, tuple(document.calibration)
    return monitor, document


def require_layout(document: MonitorDocument, given: dict[str, Any], owner: str) -> None:
    """Refuse episodes of another layout than the monitor was fitted on.

    Raises:
        ValueError: If representation, horizon or width of the observation differ.
    """
    for name, value in given.items():
        fitted = getattr(document, name)
        if fitted != value:
            raise ValueError(
                f"{owner} has {name} {value!r} and the monitor was fitted for {fitted!r}, expected the same: fit a "
                "monitor on calibration episodes of this policy and environment"
            )
