"""Fields that a configuration leaves open, filled in from the training data when a policy is built."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from lerobot.utils.constants import ACTION

from dualhead_envs import ENVIRONMENTS
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.representation import RepresentationLayout, require_observations

#: Actions executed of every chunk on robots (receding horizon of 8 of 16).
ROBOT_ACTION_STEPS = 8
#: Noise on the normalised observation in training on robots.
OBSERVATION_NOISE = 0.05
#: Gain of the embedding for film on rings of three and more modes. Where these are equally likely, neither mean nor
#: covariance of the paths depends on the condition: what is left to learn from is its product with the token.
MANY_MODES_GAIN = 8.0
RINGS_OF_MANY_MODES = [
    env_id for env_id, registered in ENVIRONMENTS.items() if registered.get("kwargs", {}).get("n_modes", 0) > 2
]


def resolve_representation(config: DualheadConfig, dataset_meta: Any | None) -> RepresentationLayout:
    """The layout of a policy: its configuration's, which is filled in from the dataset where it is new.

    Args:
        config: The policy's configuration; ``representation`` is set here.
        dataset_meta: Metadata of the training data, or None.

    Raises:
        ValueError: If there is neither, or dataset or environment have another layout than the configuration.
    """
    if dataset_meta is not None:
        given = RepresentationLayout.from_names(dataset_meta.features[ACTION].get("names"))
        given.kinematic_map = config.kinematic_map or given.kinematic_map
        if config.representation is None:
            config.representation = given
        config.representation.require_same(given, owner="the policy", given=f"dataset {dataset_meta.repo_id}")
    layout = config.representation
    if layout is None:
        raise ValueError(
            "a new dualhead policy needs a dataset to learn its action layout from: give --dataset.repo_id "
            "and --dataset.root, or load a trained policy with --policy.path"
        )
    given_name = getattr(config.action_feature, "layout_name", None)
    if given_name is not None and given_name != layout.kinematic_map:
        raise ValueError(
            f"the environment's layout is {given_name!r}, the policy's is {layout.kinematic_map!r}: evaluate in the "
            "environment and representation that the policy was trained on"
        )
    require_observations(config.input_features or {}, getattr(config.action_feature, "observation_widths", {}))
    width = config.action_feature.shape[0]
    if width != len(layout.names):
        raise ValueError(
            f"the environment or dataset has {width} action dimensions, the policy's {layout.kinematic_map!r} layout "
            f"has {len(layout.names)}: use the environment and representation that the policy was trained on"
        )
    if config.rotation_head and not layout.rotation:
        raise ValueError(
            f"policy.rotation_head=true needs an orientation, but the {layout.kinematic_map!r} layout has none: leave "
            "it out, or train on a dataset with rotation.* actions"
        )
    return layout


def fill_in_defaults(config: DualheadConfig, layout: RepresentationLayout, *, is_new: bool) -> None:
    """Set what depends on layout and environment; on the ring an episode is one chunk, on robots it is many.

    Args:
        config: The policy's configuration, its ``environment`` noted.
        layout: Its layout.
        is_new: Whether the policy is new, not a checkpoint's.
    """
    on_ring = layout.ring_map is not None
    if config.embedding_gain is None:
        # A checkpoint that does not say is older than the field.
        many = is_new and config.environment in RINGS_OF_MANY_MODES
        config.embedding_gain = MANY_MODES_GAIN if many and config.conditioning == "film" else 1.0
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
        mode = "identity" if layout.ring_map is not None else "mean_std"
    physical = {*layout.rotation, *layout.gripper}
    return [mode == "mean_std" and name not in physical for name in layout.names]
