"""Fit a policy's action scale, chunk frames and observation range to its training data, when it is built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.dataset_frames import read_split
from dualhead_policy.fitting.configuration import normalized_dimensions
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.processor_dualhead import observation_stats

#: Windows used at most, evenly spaced; a covariance of 112 dimensions needs no more.
MAX_WINDOWS = 60_000


def fit_scales(
    model: DualheadModel,
    observation_keys: Sequence[str],
    stats: Mapping[str, Mapping[str, Any]] | None,
    dataset_meta: Any | None,
) -> None:
    """Set every scale of a new policy; one without dataset and statistics keeps what will be loaded into it.

    Args:
        model: The model, in whose buffers the scales are kept.
        observation_keys: What the observation is made of, in order.
        stats: Statistics of the training data.
        dataset_meta: Metadata of the training data.

    Raises:
        ValueError: If a dataset comes without statistics, or has no episode as long as a chunk.
    """
    if stats is None:
        if dataset_meta is not None:
            raise ValueError("the dataset comes without statistics: expected meta/stats.json; record the dataset again")
        return
    config = model.config
    normalized = normalized_dimensions(config, model.layout)
    model.action_scale.fit(stats, normalized=normalized, std_floor=config.action_std_floor)
    _fit_ranges(model, observation_keys, stats)
    if model.frames and dataset_meta is not None:
        _fit_frames(model, observation_keys, stats, dataset_meta.root)


def _fit_ranges(model: DualheadModel, observation_keys: Sequence[str], stats: Mapping[str, Mapping[str, Any]]) -> None:
    """Set the ranges that smallest and largest values of the training data give."""
    moments = observation_stats(model.config, stats)
    observed = [_extremes(stats, key, model.action_scale.shift) for key in observation_keys]
    low, high = (
        torch.cat([_normalised(pair[side], moments[key]) for key, pair in zip(observation_keys, observed, strict=True)])
        for side in (0, 1)
    )
    model.observation_range.fit(low, high)
    actions = [model.action_scale.normalize(side) for side in _extremes(stats, "action", model.action_scale.shift)]
    for head, part in model.head_slices.items():
        model.endpoint_range(head).fit(*(side[part].repeat(model.config.chunk_size) for side in actions))


def _extremes(stats: Mapping[str, Mapping[str, Any]], key: str, like: Tensor) -> tuple[Tensor, Tensor]:
    """Smallest and largest training value of a feature, per dimension.

    Raises:
        ValueError: If the statistics lack them, or they are not finite.
    """
    sides = [torch.as_tensor(stats.get(key, {}).get(name, torch.nan)).to(like).flatten() for name in ("min", "max")]
    if not all(torch.isfinite(side).all() for side in sides):
        raise ValueError(
            f"the dataset's statistics lack a finite min and max of {key!r}: expected meta/stats.json with both for "
            "every feature; record the dataset again"
        )
    return sides[0], sides[1]


def _fit_frames(
    model: DualheadModel,
    observation_keys: Sequence[str],
    stats: Mapping[str, Mapping[str, Any]],
    root: str | Path,
) -> None:
    config = model.config
    split = read_split(root)
    starts = split.window_starts(config.chunk_size)
    if len(starts) == 0:
        raise ValueError(
            f"{root} has no episode of {config.chunk_size} actions: record longer episodes or lower policy.chunk_size"
        )
    starts = starts[:: -(-len(starts) // MAX_WINDOWS)]
    moments = observation_stats(config, stats)
    parts = [_normalised(torch.from_numpy(split.observation[key][starts]), moments[key]) for key in observation_keys]
    observation = torch.cat(parts, dim=-1).to(model.action_scale.shift)
    windows = torch.from_numpy(split.action[starts[:, None] + np.arange(config.chunk_size)])
    normalised = model.action_scale.normalize(windows.to(model.action_scale.shift))
    for head, part in model.head_slices.items():
        frame = model.frame(head).fit(observation, normalised[..., part].flatten(1), config.observation_noise or 0.0)
        clean = frame.enter(normalised[..., part].flatten(1), observation)
        model.endpoint_range(head).fit(clean.amin(dim=0), clean.amax(dim=0))


def _normalised(observation: Tensor, moments: Mapping[str, Tensor]) -> Tensor:
    return (observation - moments["mean"]) / (moments["std"] + 1e-8)
