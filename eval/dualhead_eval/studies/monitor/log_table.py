"""The log as a table: a row per decision, what was observed and what became of the episode; all that scoring needs."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.evaluation.conditions import environment_partition
from dualhead_eval.monitor.decision_builder import DecisionBuilder
from dualhead_eval.monitor.recorded_episodes import OBSERVATIONS, open_rollouts
from dualhead_eval.studies.monitor.recording import CALIBRATION, parts
from dualhead_eval.studies.monitor.registration import Budget, Registration

FORMAT = "dualhead-monitor-log/1"
_METADATA = b"dualhead"
#: What is known of an episode, with its type.
EPISODE = {
    "part": pa.string(),
    "seed": pa.int64(),
    "success": pa.bool_(),
    "failure": pa.string(),
    "stratum": pa.string(),
    "steps": pa.int64(),
    "onset": pa.int64(),
}
#: Step of stored observations: .06 mrad and .06 mm, far below any sensor; half the bytes of a float are its last bits.
OBSERVATION_STEP = 2.0**-14
_COLUMNS = {"episode": pa.int64(), "step": pa.int64(), "flagged": pa.bool_()}


@dataclass(frozen=True)
class MonitorLog:
    """Decisions of the executing policy, in order of parts, episodes and steps.

    Attributes:
        episodes: What is known of every episode, a list a column of :data:`EPISODE`.
        episode: Episode of every decision ``(D,)``.
        step: Control step of every decision ``(D,)``.
        flagged: Whether two modes were open there ``(D,)``.
        observations: Observed vectors by LeRobot key, each ``(D, width)``, in their own units, to the nearest
            :data:`OBSERVATION_STEP`; none in an older log that was kept for its verdicts alone.
        about: Environment, layout and names that a decision's builder needs, and the executor's provenance.
    """

    episodes: dict[str, list[Any]]
    episode: NDArray[np.int64]
    step: NDArray[np.int64]
    flagged: NDArray[np.bool_]
    observations: dict[str, NDArray[np.float32]]
    about: dict[str, Any]

    def __len__(self) -> int:
        return len(self.step)

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return len(self.episodes["part"])

    @property
    def calibrating(self) -> NDArray[np.bool_]:
        """Whether each episode calibrates ``(E,)``; the others are the test."""
        return np.array(self.episodes["part"]) == CALIBRATION

    def rows(self, episode: int) -> slice:
        """The decisions of one episode."""
        first, after = np.searchsorted(self.episode, [episode, episode + 1])
        return slice(int(first), int(after))

    def builder(self) -> DecisionBuilder:
        """Makes decisions from observations and samples; flags come from the log."""
        about = self.about
        partition = environment_partition(about["env_id"], about["env_kwargs"], "the log")
        return DecisionBuilder(about["layout"], about["state_names"], about["env_kwargs"]["control"], partition)


def collect_log(
    folder: Path,
    protocol: Registration,
    budget: Budget,
    flag: Callable[[NDArray[np.float64]], bool],
    progress: Callable[[int], object] | None = None,
) -> MonitorLog:
    """The log of every recorded part: of calibration the first successes, of the test all episodes.

    Args:
        folder: Where the parts were recorded.
        protocol: The protocol.
        budget: Its size.
        flag: Says of a raw observation whether two modes are open.
        progress: Called with 1 after every episode.

    Raises:
        FileNotFoundError, ValueError: If a part is missing or damaged.
    """
    episodes: dict[str, list[Any]] = {name: [] for name in EPISODE}
    rows: dict[str, list[Any]] = {name: [] for name in (*_COLUMNS, *OBSERVATIONS)}
    about: dict[str, Any] = {}
    for part in parts(protocol, budget):
        recorded = open_rollouts(folder / part.name)
        kept = 0
        for number in range(len(recorded)):
            outcome = recorded.outcomes[number]
            calibrates = part.name == CALIBRATION
            if calibrates and (not outcome["success"] or kept == budget.calibration_kept):
                continue
            kept += 1
            frames = recorded.frames(number)
            decisions = recorded.decision_frames(number)
            known = recorded.episode_facts(number)
            for name, value in {"part": part.name, "seed": outcome["seed"], **known}.items():
                episodes[name].append(value)
            for frame in decisions:
                observed = {key: recorded.columns[key][frame] for key in OBSERVATIONS}
                rows["episode"].append(len(episodes["part"]) - 1)
                rows["step"].append(int(frame - frames[0]))
                rows["flagged"].append(flag(np.concatenate(list(observed.values())).astype(np.float64)))
                for key, values in observed.items():
                    rows[key].append(values)
            if progress is not None:
                progress(1)
        sidecar = recorded.sidecar
        about = about or {
            "env_id": sidecar["env_id"],
            "env_kwargs": {k: v for k, v in sidecar["env_kwargs"].items() if k != "perturbation"},
            "layout": sidecar["layout"],
            "horizon": sidecar["horizon"],
            "state_names": recorded.state_names,
            "executor": sidecar.get("policy", {}),
        }
    return MonitorLog(
        episodes,
        np.array(rows["episode"], dtype=np.int64),
        np.array(rows["step"], dtype=np.int64),
        np.array(rows["flagged"], dtype=bool),
        {key: rounded_observations(np.stack(rows[key])) for key in OBSERVATIONS},
        about,
    )


def rounded_observations(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """Observations on the grid of :data:`OBSERVATION_STEP`; a log is scored as it is stored."""
    return (np.round(values.astype(np.float64) / OBSERVATION_STEP) * OBSERVATION_STEP).astype(np.float32)


def write_log(log: MonitorLog, path: Path) -> None:
    """Write the log as one Parquet file, atomically; what is known of episodes lies in its metadata."""
    table = {name: pa.array(getattr(log, name), kind) for name, kind in _COLUMNS.items()}
    for key, values in log.observations.items():
        table[key] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
    document = json.dumps({"format": FORMAT, "about": log.about, "episodes": log.episodes})
    content = io.BytesIO()
    made = pa.table(table).replace_schema_metadata({_METADATA: document.encode()})
    pq.write_table(
        made,
        content,
        compression="zstd",
        compression_level=19,
        # Measured floats share sign and exponent with their neighbours: bytes of one place together compress best.
        use_dictionary=list(_COLUMNS),
        use_byte_stream_split=[f"{key}.list.element" for key in log.observations],
        write_page_checksum=True,
    )
    write_bytes(path, content.getvalue())


def read_log(path: Path) -> MonitorLog:
    """Read the log.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is damaged or of another kind.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist, expected the log of a monitor study: run the study first")
    again = "delete it, and repeat the study's command"
    try:
        table = pq.read_table(path, page_checksum_verification=True)
        document = json.loads((table.schema.metadata or {}).get(_METADATA, b"{}"))
        if document.get("format") != FORMAT:
            raise ValueError(f"its format is {document.get('format')!r}")
        log = MonitorLog(
            {name: document["episodes"][name] for name in EPISODE},
            table["episode"].to_numpy(),
            table["step"].to_numpy(),
            table["flagged"].to_numpy(zero_copy_only=False),
            {
                key: np.stack(table[key].to_numpy(zero_copy_only=False))
                for key in OBSERVATIONS
                if key in table.column_names
            },
            document["about"],
        )
        lengths = {len(values) for values in log.episodes.values()}
        if lengths != {int(log.episode.max()) + 1} or (np.diff(log.episode) < 0).any():
            raise ValueError("its decisions and episodes do not fit")
    except (pa.ArrowException, OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path} is not the log of a monitor study ({reason}): {again}") from error
    return log
