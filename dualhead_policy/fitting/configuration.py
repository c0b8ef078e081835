"""Fields that a configuration leaves open, filled in from the layout when a policy is built."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch

from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.representation import RepresentationLayout

#: Actions executed of every chunk on robots (receding horizon of 8 of 16).
ROBOT_ACTION_STEPS = 8
#: Noise on the normalised observation in training on robots.
OBSERVATION_NOISE = 0.05


def fill_in_defaults(config: DualheadConfig, layout: RepresentationLayout) -> None:
    """Set what depends on the layout; on the ring an episode is one chunk, on robots it is many."""
    on_ring = layout.kinematic_map.startswith("ring/")
    if config.n_action_steps is None:
        config.n_action_steps = config.chunk_size if on_ring else min(ROBOT_ACTION_STEPS, config.chunk_size)
    if config.padded_steps is None:
        config.padded_steps = 0 if on_ring else config.chunk_size - 1
    if config.observation_noise is None:
        config.observation_noise = 0.0 if on_ring else OBSERVATION_NOISE
    if config.preconditioning == "auto":
        config.preconditioning = "gaussian" if on_ring else "linear_gaussian"
    if config.seed is None:
        config.seed = torch.initial_seed() % 2**31


def note_origin(config: DualheadConfig, dataset_meta: Any) -> None:
    """Write down which dataset, and which environment behind it, a policy is trained on."""
    config.dataset_name = dataset_meta.repo_id
    sidecar = Path(dataset_meta.root) / "meta" / "dualhead.json"
    config.environment = json.loads(sidecar.read_text()).get("env_id") if sidecar.is_file() else None


def normalized_dimensions(config: DualheadConfig, layout: RepresentationLayout) -> list[bool]:
    """Which dimensions of the dual action vector are normalised by their mean and standard deviation.

    Rotations and the gripper never are; with ``"auto"`` the ring's are not either, so that trained networks and the
    exact reference share one noise scale.
    """
    mode = config.normalize_actions
    if mode == "auto":
        mode = "identity" if layout.kinematic_map.startswith("ring/") else "mean_std"
    physical = {*layout.rotation, *layout.gripper}
    return [mode == "mean_std" and name not in physical for name in layout.names]
