"""The decisions of recorded rollouts: what both heads predicted at each, as positions in metres."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_envs.dataset_columns import read_columns, read_info
from dualhead_envs.dataset_sidecar import SIDECAR, read_rollout_sidecar
from dualhead_eval.evaluation.labelled_pairs import HEADS, ModePartition

#: Both heads of a dual-head policy, or two draws of one of LeRobot's other types.
_HEADS = ("prediction.joint", "prediction.position")
_DRAWS = ("prediction.draw_1", "prediction.draw_2")


@dataclass(frozen=True)
class RecordedDecisions:
    """Every decision of a rollout dataset, in order.

    Attributes:
        sidecar: What the recording says of itself (``meta/dualhead.json``).
        partition: The mode partition of its environment.
        frame: Index of each decision's frame in the dataset (D,).
        episode: Episode of each decision (D,).
        condition: ``environment_state`` at each decision (D, C).
        joint: The joint head's chunks as positions (D, n, H, d) in metres; or first draws.
        position: The position head's chunks (D, n, H, d) in metres; or second draws.
        held: How many of the n pairs follow the token or latent that the episode holds.
        heads: What the two are called.
    """

    sidecar: dict[str, Any]
    partition: ModePartition
    frame: np.ndarray
    episode: np.ndarray
    condition: np.ndarray
    joint: np.ndarray
    position: np.ndarray
    held: int
    heads: tuple[str, str] = HEADS


def read_decisions(root: str | Path) -> RecordedDecisions:
    """The decisions of a rollout dataset.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it holds no predictions of both heads, does not say which pairs are held, or describes another
            partition than its environment has.
    """
    # Reading outcomes alone, as a report does, needs none of these.
    import torch

    from dualhead_eval.evaluation.conditions import environment_partition
    from dualhead_policy.kinematics.kinematic_map import KinematicMap

    root = Path(root)
    info, sidecar = read_info(root), read_rollout_sidecar(root / SIDECAR)
    drawn = _DRAWS[0] in info["features"]
    pair = _DRAWS if drawn else _HEADS
    keys = [*pair, "prediction.decision"]
    missing = [key for key in keys if key not in info["features"]]
    if missing:
        raise ValueError(
            f"{root} is not a dataset of recorded rollouts (lacks {missing}): record one with `dualhead evaluate "
            "--policy ... --record DIR`"
        )
    columns = read_columns(root, info, [*keys, "observation.environment_state", "episode_index"])
    decision = columns["prediction.decision"].reshape(-1).astype(bool)
    if not decision.any():
        raise ValueError(f"{root} holds no decision: expected prediction.decision to be true in some frames")
    n, held, horizon = sidecar["samples"], sidecar.get("held_pairs"), sidecar["horizon"]
    if held is None or held >= n:
        raise ValueError(
            f"{root / SIDECAR} has held_pairs={held} of samples={n}, expected how many pairs of a decision follow the "
            "episode's token or latent, and fresh pairs beside them: record the rollouts again"
        )
    partition = environment_partition(sidecar["env_id"], sidecar["env_kwargs"], str(root))
    if json.loads(json.dumps(partition.to_dict())) != sidecar["partition"]:
        raise ValueError(
            f"{root / SIDECAR} describes another partition than its environment has: record the rollouts again with "
            "this version"
        )

    def chunks(key: str) -> np.ndarray:
        values = columns[key][decision]
        if values.shape[1] % (n * horizon) or not np.isfinite(values).all():
            raise ValueError(
                f"{root} holds {key} of {values.shape[1]} numbers or some that are not finite, expected {n} chunks of "
                f"{horizon} actions: record the rollouts again"
            )
        return values.reshape(len(values), n, horizon, -1)

    first, second = (chunks(key).astype(np.float64) for key in pair)
    if not drawn:
        first = KinematicMap(sidecar["layout"]).position(torch.from_numpy(first)).numpy()
    return RecordedDecisions(
        sidecar=sidecar,
        partition=partition,
        frame=np.flatnonzero(decision),
        episode=columns["episode_index"].reshape(-1)[decision],
        condition=columns["observation.environment_state"][decision],
        joint=first,
        position=second,
        held=held,
        heads=("draw 1", "draw 2") if drawn else HEADS,
    )
