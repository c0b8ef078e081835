"""Conditions from any LeRobotDataset: one frame of every episode, with a partition of one's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dualhead_envs.dataset_frames import SplitFrames, read_split
from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.partitions.scored import ScoredPartition


@dataclass(frozen=True)
class FrameConditions:
    """How a dataset's frames become conditions.

    Attributes:
        horizon: Steps of the window in which a mode is told, from the condition's frame on.
        frame: Which frame of every episode is the condition, from 0.
        path_names: Dimensions of the action that are the path; empty for those called ``position.*``.
        metres: Whether the path is in metres.
    """

    horizon: int
    frame: int = 0
    path_names: tuple[str, ...] = ()
    metres: bool = False


def open_frame_conditions(
    root: str | Path,
    how: FrameConditions,
    make_partition: Callable[[np.ndarray], ScoredPartition],
    limit: int | None = None,
) -> ConditionBank:
    """One frame of every episode of a dataset, the first ``limit`` of them or all.

    The mode frequencies of the data are those of the demonstrated windows, where all of them are valid ones.

    Args:
        root: Folder of a LeRobotDataset v3.0 of states; its actions are absolute positions, or hold them.
        how: Which frame, window and dimensions.
        make_partition: The partition, given the demonstrated paths (episodes, H, d).
        limit: Episodes to use.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If an episode is too short, a dimension is missing, or there are fewer episodes than ``limit``.
    """
    frames = read_split(root)
    if how.horizon < 1 or how.frame < 0:
        raise ValueError(f"--horizon {how.horizon} and --frame {how.frame}, expected at least 1 and at least 0")
    present = np.flatnonzero(frames.frame_index == how.frame)
    if limit is not None and not 1 <= limit <= len(present):
        raise ValueError(f"{root} holds {len(present)} conditions, {limit} were asked for: give 1 to that many")
    episodes = int(frames.episode_index.max()) + 1
    fitting = np.isin(present, frames.window_starts(how.horizon))
    if len(present) < episodes or not fitting.all():
        raise ValueError(
            f"{root} has episodes that end before frame {how.frame + how.horizon}, expected {how.horizon} actions from "
            f"frame {how.frame} on in each: give a shorter --horizon or an earlier --frame"
        )
    names = how.path_names or tuple(name for name in frames.action_names if name.startswith("position."))
    unknown = [name for name in names if name not in frames.action_names]
    if unknown or not names:
        raise ValueError(
            f"{root} has the action dimensions {frames.action_names[:8]}, expected --path-names among them: which "
            f"are the path{f', not {unknown[0]!r}' if unknown else ''}"
        )
    demonstrated = _windows(frames, present, how.horizon, names)
    partition = make_partition(demonstrated)
    observation = {key: column[present] for key, column in frames.observation.items()}
    state = observation.get("observation.environment_state", next(iter(observation.values())))
    bank = ConditionBank(
        observation=observation,
        pair_ids=frames.episode_index[present],
        partition=partition,
        kinematic_map="",
        target_probabilities=_frequencies(partition, demonstrated, state),
        direction=None,
        env_kwargs={},
        provenance={
            "dataset": {
                "name": frames.root.resolve().name,
                "fingerprint": frames.fingerprint,
                "frame": how.frame,
                "horizon": how.horizon,
                "path": list(names),
            }
        },
        horizon=how.horizon,
        action_names=tuple(frames.action_names),
        path_names=names,
        metres=how.metres,
        frames=(frames, present),
    )
    return bank[:limit]


def _frequencies(partition: ScoredPartition, demonstrated: np.ndarray, state: np.ndarray) -> list[float] | None:
    """How often the demonstrations take each mode; None if one of them takes none."""
    label = partition.assign(demonstrated, state)
    if (label < 0).any():
        return None
    return (np.bincount(label, minlength=partition.n_modes) / len(label)).tolist()


def _windows(frames: SplitFrames, present: np.ndarray, horizon: int, names: Sequence[str]) -> np.ndarray:
    """The demonstrated paths (episodes, H, d) from each condition's frame on."""
    columns = [frames.action_names.index(name) for name in names]
    return frames.action[:, columns][present[:, None] + np.arange(horizon)].astype(np.float64)
