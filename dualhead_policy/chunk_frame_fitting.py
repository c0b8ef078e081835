"""Fit the heads' chunk frames to the training windows, when a policy is built."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.dataset_frames import read_split
from dualhead_policy.action_scale import ActionScale
from dualhead_policy.chunk_frame import ChunkFrame
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.observation_range import ObservationRange
from dualhead_policy.processor_dualhead import observation_stats

#: Windows used at most, evenly spaced; a covariance of 112 dimensions needs no more.
MAX_WINDOWS = 60_000


def fit_chunk_frames(
    frames: Mapping[str, ChunkFrame],
    observation_range: ObservationRange,
    config: DualheadConfig,
    root: str | Path,
    stats: Mapping[str, Mapping[str, Any]],
    action_scale: ActionScale,
    head_slices: Mapping[str, slice],
    observation_keys: list[str],
) -> None:
    """Fit every head's frame, and the range of the observations.

    Args:
        frames: The frames, by head.
        observation_range: The range.
        config: The policy's configuration.
        root: Folder of the training split.
        stats: Its statistics: observations are normalised as the preprocessor will.
        action_scale: Scale of the actions.
        head_slices: Where each head's dimensions lie in the dual action vector.
        observation_keys: Observations in the order in which the policy concatenates them.

    Raises:
        ValueError: If statistics are missing, or no window of ``chunk_size`` actions fits into an episode.
    """
    split = read_split(root)
    starts = split.window_starts(config.chunk_size)
    if len(starts) == 0:
        raise ValueError(
            f"{root} has no episode of {config.chunk_size} actions: record longer episodes or lower policy.chunk_size"
        )
    starts = starts[:: -(-len(starts) // MAX_WINDOWS)]
    moments = observation_stats(config, stats)
    parts = [_normalised(torch.from_numpy(split.observation[key][starts]), moments[key]) for key in observation_keys]
    observation = torch.cat(parts, dim=-1).to(action_scale.shift)
    observation_range.fit(observation)
    windows = torch.from_numpy(split.action[starts[:, None] + np.arange(config.chunk_size)])
    normalised = action_scale.normalize(windows.to(action_scale.shift))
    for head, frame in frames.items():
        chunk = normalised[..., head_slices[head]].flatten(1)
        frame.fit(observation, chunk, config.observation_noise or 0.0)


def _normalised(observation: Tensor, moments: Mapping[str, Tensor]) -> Tensor:
    return (observation - moments["mean"]) / (moments["std"] + 1e-8)
