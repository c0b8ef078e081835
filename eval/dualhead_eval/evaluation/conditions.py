"""Conditions to evaluate under: the branch points of a recorded split's pairs, with the modes that lie ahead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_envs.dataset_frames import SplitFrames, read_split
from dualhead_envs.recorded_environment import make_recorded
from dualhead_eval.evaluation.labelled_pairs import ModePartition
from dualhead_eval.residuals.distances import mode_direction


@dataclass(frozen=True)
class ConditionBank:
    """Conditions to evaluate under, and whose modes they have.

    Attributes:
        observation: Raw observations by LeRobot key, each (B, dim).
        pair_ids: Demonstration pair of each condition (B,).
        partition: The environment's mode partition.
        kinematic_map: The dataset's or environment's map from head A's space to the position; empty if unknown.
        target_probabilities: Mode frequencies of the data, or None if unknown.
        direction: Direction that separates the modes of every condition (B, d), or None where a pair of
            demonstrations is incomplete.
        env_kwargs: Keyword arguments of the environment.
        provenance: Where the conditions came from.
        horizon: Steps of the window after the branch, in which a mode is told.
        action_names: Names of the dimensions of the dataset's action.
        path_names: Dimensions of the action that are the path; empty for those called ``position.*`` or ``joint.*``.
        metres: Whether paths are in metres.
        frames: The split that the conditions are frames of, and which; None where only they are known.
    """

    observation: Mapping[str, np.ndarray]
    pair_ids: np.ndarray
    partition: ModePartition
    kinematic_map: str
    target_probabilities: list[float] | None
    direction: np.ndarray | None
    env_kwargs: dict[str, Any]
    provenance: dict[str, Any]
    horizon: int = 16
    action_names: tuple[str, ...] = ()
    path_names: tuple[str, ...] = ()
    metres: bool = True
    frames: tuple[SplitFrames, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self.pair_ids)

    @property
    def state(self) -> np.ndarray:
        """The environment's state of every condition (B, C); the robot's where the dataset has no other."""
        return self.observation.get("observation.environment_state", next(iter(self.observation.values())))

    def __getitem__(self, rows: slice) -> ConditionBank:
        """Some of the conditions."""
        return replace(
            self,
            observation={key: value[rows] for key, value in self.observation.items()},
            pair_ids=self.pair_ids[rows],
            direction=None if self.direction is None else self.direction[rows],
            frames=None if self.frames is None else (self.frames[0], self.frames[1][rows]),
        )

    def history(self, steps: int) -> dict[str, np.ndarray]:
        """The last ``steps`` observations of every condition, as its demonstration went: each (B, steps, dim).

        Raises:
            ValueError: If the conditions are no frames of a recorded split and more than the present one is asked for.
        """
        if steps == 1:
            return {key: value[:, None] for key, value in self.observation.items()}
        if self.frames is None:
            raise ValueError(
                f"the conditions are single observations, expected {steps} in a row: open a recorded split"
            )
        return self.frames[0].history(self.frames[1], steps)


def open_conditions(root: str | Path, limit: int | None = None) -> ConditionBank:
    """The branch points of a recorded split's pairs, the first ``limit`` of them or all.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it is not a demonstration dataset of this package, or has fewer conditions than ``limit``.
    """
    frames = read_split(root)
    if not {"pair", "branch_step"} <= set(frames.labels):
        raise ValueError(
            f"{root} lacks the columns 'pair' and 'branch_step': expected a split written by `dualhead record`"
        )
    env_id, env_kwargs = recorded_environment(frames)
    conditions = frames.conditions()
    if limit is not None and not 1 <= limit <= len(conditions):
        raise ValueError(f"{root} holds {len(conditions)} conditions, {limit} were asked for: give 1 to that many")
    horizon = frames.sidecar.get("horizon", 16)
    windows = frames.mode_windows(horizon)
    bank = ConditionBank(
        observation=conditions.observation,
        pair_ids=conditions.pair,
        partition=environment_partition(env_id, env_kwargs, str(frames.root)),
        kinematic_map=frames.sidecar["layout"],
        target_probabilities=frames.sidecar.get("mode_probabilities"),
        direction=None if windows is None else mode_direction(windows),
        env_kwargs=env_kwargs,
        provenance={
            "dataset": {
                "env_id": env_id,
                "env_kwargs": env_kwargs,
                "split": frames.sidecar.get("split"),
                "fingerprint": frames.fingerprint,
            }
        },
        horizon=horizon,
        action_names=tuple(frames.action_names),
        frames=(frames, conditions.frame),
    )
    return bank[:limit]


def recorded_environment(frames: SplitFrames) -> tuple[str, dict[str, Any]]:
    """Id and keyword arguments of the environment that a split was recorded from.

    Raises:
        ValueError: If the dataset does not say which environment it comes from.
    """
    env_id = frames.sidecar.get("env_id")
    if env_id is None:
        raise ValueError(
            f"{frames.root} does not say which environment it comes from (no meta/dualhead.json): expected a "
            "dataset written by `dualhead record`"
        )
    return env_id, frames.sidecar.get("env_kwargs", {})


def environment_partition(env_id: str, env_kwargs: Mapping[str, Any], source: str) -> ModePartition:
    """The mode partition of an environment that a recording named.

    Raises:
        ValueError: If there is no such environment, or it does not take these arguments.
    """
    env = make_recorded(env_id, env_kwargs, source)
    partition = env.unwrapped.mode_partition  # type: ignore[attr-defined]
    env.close()
    return partition
