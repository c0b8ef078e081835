"""Episodes of a rollout dataset: what ``dualhead evaluate --record`` wrote, or any data in that format."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_envs.dataset_columns import read_columns, read_info
from dualhead_envs.dataset_frames import read_split
from dualhead_envs.dataset_sidecar import SIDECAR, read_rollout_sidecar
from dualhead_eval.evaluation.conditions import environment_partition
from dualhead_eval.monitor.decision import Decision, Episode
from dualhead_eval.monitor.decision_builder import DecisionBuilder

PREDICTIONS = ("prediction.joint", "prediction.position", "prediction.decision")
OBSERVATIONS = ("observation.state", "observation.environment_state")


@dataclass(frozen=True)
class RecordedEpisodes:
    """A rollout dataset in memory, one episode at a time.

    Attributes:
        root: Its folder.
        sidecar: Its ``meta/dualhead.json``.
        columns: Its columns by key, in order of the frames.
        builder: Makes its decisions.
        names: Names of the observed dimensions, their number where they have none.
        state_names: Names of the proprioception's dimensions, as the dataset gives them.
    """

    root: Path
    sidecar: dict[str, Any]
    columns: dict[str, NDArray]
    builder: DecisionBuilder
    names: tuple[str, ...] = ()
    state_names: list[str] | None = None

    @property
    def samples(self) -> int:
        """Recorded pairs per decision."""
        return int(self.sidecar["samples"])

    @property
    def layout(self) -> dict[str, Any]:
        """What a monitor must have been fitted for: representation, horizon and width of the observation."""
        width = sum(self.columns[key].shape[1] for key in OBSERVATIONS)
        return {"layout": self.sidecar["layout"], "horizon": int(self.sidecar["horizon"]), "observation": width}

    @property
    def stratum(self) -> str:
        """Kind and level of the perturbation that all episodes share, ``"nominal"`` without one."""
        return str(self.sidecar["env_kwargs"].get("perturbation") or "nominal")

    @property
    def outcomes(self) -> list[dict[str, Any]]:
        """What became of every episode of the dataset; those refused before their first frame are not in it."""
        return [outcome for outcome in self.sidecar["outcomes"] if outcome.get("frames") != 0]

    @property
    def seeds(self) -> set[int]:
        """Seeds of the episodes' initial states."""
        return {int(outcome["seed"]) for outcome in self.outcomes}

    def __len__(self) -> int:
        return len(self.outcomes)

    def frames(self, episode: int) -> NDArray[np.int64]:
        """Indices of the frames of an episode."""
        return np.flatnonzero(self.columns["episode_index"] == episode)

    def decision_frames(self, episode: int) -> NDArray[np.int64]:
        """Indices of the frames at which its policy decided."""
        frames = self.frames(episode)
        return frames[self.columns["prediction.decision"][frames].reshape(-1).astype(bool)]

    def chunks(self, key: str, frame: int) -> NDArray[np.float64]:
        """Recorded samples ``(n, H, d)`` at one frame."""
        return self.columns[key][frame].reshape(self.samples, int(self.sidecar["horizon"]), -1)

    def episode(self, number: int, samples: Callable[[int], tuple[NDArray, NDArray]] | None = None) -> Episode:
        """One episode, with its own predictions or, of another policy, what ``samples`` gives per frame."""
        state, context = (self.columns[key] for key in OBSERVATIONS)
        decisions = []
        frames = self.frames(number)
        for frame in self.decision_frames(number):
            if samples is None:
                joint, position = (self.chunks(key, frame) for key in PREDICTIONS[:2])
            else:
                joint, position = samples(int(frame))
            step = int(frame - frames[0])
            decisions.append(self.builder.build(step, state[frame], context[frame], joint, position))
        return Episode(
            decisions=tuple(decisions),
            **self.episode_facts(number),
            key=f"{self.root.name}/{self.outcomes[number]['seed']}",
        )

    def episode_facts(self, number: int) -> dict[str, Any]:
        """What became of an episode: the fields of :class:`Episode` but for its decisions and key."""
        outcome = self.outcomes[number]
        success = bool(outcome["success"])
        word = "none" if success else "collision" if outcome.get("collision") else "unknown"
        return {
            "success": success,
            "failure": "refused" if outcome.get("refused") else str(outcome.get("failure") or word),
            "stratum": self.stratum,
            "steps": len(self.frames(number)),
            "onset": None if outcome.get("onset") in (None, -1) else int(outcome["onset"]),
        }

    def __iter__(self) -> Iterator[Episode]:
        return (self.episode(number) for number in range(len(self)))


def open_rollouts(root: str | Path, *, flag: Callable[[NDArray[np.float64]], bool] | None = None) -> RecordedEpisodes:
    """Open a rollout dataset.

    Args:
        root: Its folder.
        flag: Says of an observation whether two modes are open.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it is damaged, or holds no predictions of both heads or no outcomes.
    """
    root = Path(root)
    info, sidecar = read_info(root), read_rollout_sidecar(root / SIDECAR)
    missing = [key for key in (*PREDICTIONS, *OBSERVATIONS) if key not in info["features"]]
    if missing:
        raise ValueError(
            f"{root} is not a dataset of recorded rollouts (lacks {', '.join(missing)}): record one with "
            "`dualhead evaluate --policy ... --record DIR`"
        )
    columns = read_columns(root, info, [*PREDICTIONS, *OBSERVATIONS, "episode_index"])
    recorded, outcomes = len(np.unique(columns["episode_index"])), sidecar["outcomes"]
    if recorded != sum(outcome.get("frames") != 0 for outcome in outcomes):
        raise ValueError(
            f"{root} holds {recorded} episodes and the outcomes of {len(outcomes)}, expected one each: record it again"
        )
    builder = DecisionBuilder(
        sidecar["layout"],
        info["features"]["observation.state"].get("names"),
        sidecar["env_kwargs"].get("control", "joint"),
        environment_partition(sidecar["env_id"], sidecar["env_kwargs"], str(root / SIDECAR)),
        flag,
    )
    named: list[str] = []
    for key in OBSERVATIONS:
        width = columns[key].shape[1]
        named += info["features"][key].get("names") or [f"{key}.{i}" for i in range(width)]
    state_names = info["features"]["observation.state"].get("names")
    return RecordedEpisodes(root, sidecar, columns, builder, tuple(named), state_names)


def training_decisions(root: str | Path) -> list[Decision]:
    """Every frame of a demonstration split as a decision that knows its observation alone.

    Raises:
        FileNotFoundError: If there is no such dataset.
    """
    split = read_split(root)
    rows = np.concatenate([split.observation[key] for key in OBSERVATIONS], axis=1).astype(np.float64)
    return [Decision(int(step), row) for step, row in zip(split.frame_index, rows, strict=True)]
