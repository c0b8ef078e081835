"""Pre- and post-processors of the dual-head policy: LeRobot's standard steps, actions left in physical units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from lerobot.configs import FeatureType
from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors
from torch import Tensor

from dualhead_policy.configuration_dualhead import DualheadConfig

#: A preprocessor of observations and a postprocessor of actions.
Processors = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]
#: An observation that never varies beyond this in training is passed on unscaled. The hand's tilt in the
#: demonstrations (0.2 mrad) and single precision's error in constants (0.4 mm) are below it: scaled to unit
#: variance, a tilt of half a degree would be 40 standard deviations in closed loop.
OBSERVATION_STD_FLOOR = 3e-3


def make_dualhead_pre_post_processors(
    config: DualheadConfig,
    dataset_stats: Mapping[str, Mapping[str, Any]] | None = None,
) -> Processors:
    """Rename, batch, move and normalise observations; return actions as the policy gives them.

    Args:
        config: The policy's configuration.
        dataset_stats: Statistics of the training data; None when a checkpoint's processors are loaded.

    Raises:
        ValueError: If statistics are given but one for a declared observation is missing.
    """
    stats = None if dataset_stats is None else observation_stats(config, dataset_stats)
    return make_default_pre_post_processors(config, stats, normalizer_device=config.device)


def observation_stats(
    config: DualheadConfig, dataset_stats: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Tensor]]:
    """Mean and standard deviation with which each declared observation is normalised.

    Raises:
        ValueError: If the statistics of one are missing.
    """
    stats: dict[str, dict[str, Tensor]] = {}
    for key, feature in (config.input_features or {}).items():
        if feature.type not in (FeatureType.STATE, FeatureType.ENV):
            continue
        if "mean" not in dataset_stats.get(key, {}) or "std" not in dataset_stats[key]:
            raise ValueError(
                f"the dataset's statistics lack {key!r}: expected meta/stats.json with mean and std for every "
                "feature; record the dataset again"
            )
        mean = torch.as_tensor(dataset_stats[key]["mean"], dtype=torch.float32)
        std = torch.as_tensor(dataset_stats[key]["std"], dtype=torch.float32)
        # A constant observation would otherwise be divided by nearly zero once it moves in closed loop.
        stats[key] = {"mean": mean, "std": torch.where(std < OBSERVATION_STD_FLOOR, torch.ones(()), std)}
    return stats
