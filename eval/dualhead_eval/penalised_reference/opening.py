"""The penalised reference of a recorded split: the ring's from its generator, a robot's from its demonstrations."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_envs.dataset_frames import SplitFrames, read_split
from dualhead_eval.penalised_reference.ring import PenalisedRingReference
from dualhead_eval.penalised_reference.robot import PenalisedRobotReference
from dualhead_policy.kinematics.kinematic_map import KinematicMap


def open_reference(
    root: str | Path,
    observation: Mapping[str, np.ndarray],
    consistency_weight: float,
    source_noise_beta: float,
    ring_options: Mapping[str, Any],
) -> PenalisedRingReference | PenalisedRobotReference:
    """The optimum for the conditions of the split at ``root``.

    Args:
        root: A split written by ``dualhead record``, with the training split beside it for a robot's action scale.
        observation: Raw observations of the conditions by LeRobot key, each (B, dim), the split's first B pairs.
        consistency_weight: lambda of eq:cons.
        source_noise_beta: Coupling of the source noise in training.
        ring_options: Options of the ring's generator.

    Raises:
        FileNotFoundError: If a robot's training split is missing.
        ValueError: If there is no such reference for the split.
    """
    frames = read_split(root)
    layout = frames.sidecar["layout"]
    n_modes = len(frames.sidecar["mode_probabilities"])
    if n_modes != 2:
        raise ValueError(
            f"the penalised reference knows two modes, the conditions have {n_modes}: record RotatingRing-v2, or "
            "leave out --consistency-weight"
        )
    family, _, representation = layout.partition("/")
    if family == "ring":
        return PenalisedRingReference(
            representation, consistency_weight, source_noise_beta=source_noise_beta, **ring_options
        )
    n = len(next(iter(observation.values())))
    horizon = frames.sidecar.get("horizon", 16)
    joint, position = (frames.mode_windows(horizon, prefix) for prefix in ("joint.", "position."))
    if joint is None or position is None:
        raise ValueError(
            f"{root} lacks a demonstration of each mode for every pair: the penalised reference needs both; record "
            "the dataset again"
        )
    scales = _action_scales(Path(root).parent / "train", frames)
    return PenalisedRobotReference(
        observation,
        joint[:n],
        position[:n],
        scales["joint."],
        scales["position."],
        KinematicMap(layout),
        consistency_weight,
        source_noise_beta=source_noise_beta,
    )


def _action_scales(train: Path, frames: SplitFrames) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and standard deviation of the training actions by head, in which a policy's losses are measured."""
    path = train / "meta" / "stats.json"
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist: the penalised reference measures losses in the training actions' scale and "
            "expects the train split beside the one evaluated on"
        )
    moments = json.loads(path.read_text())["action"]
    scales = {}
    for prefix in ("joint.", "position."):
        index = [i for i, name in enumerate(frames.action_names) if name.startswith(prefix)]
        mean, std = (np.asarray(moments[name], dtype=np.float64).ravel()[index] for name in ("mean", "std"))
        scales[prefix] = mean, std
    return scales
