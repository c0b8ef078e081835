"""The random draws of a training step, apart from the loss that they enter.

They are a function of (seed, step, purpose): time, source noise and token corruption come from one keyed generator,
latents and observation noise from their own, so that a mechanism leaves the draws of the others as they are, and runs
that train side by side draw what each would have drawn alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dualhead_policy.flow.flow_matching import coupled_source_noise, interpolate
from dualhead_policy.flow.keyed_random import keyed_generator, step_key
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.model.tokens import TokenCorruption


@dataclass(frozen=True)
class StepDraws:
    """Everything random in the loss of B windows.

    Attributes:
        time: t (B,) in [0, 1), the same for all heads.
        source: Source noise x_0 by head (B, H, d), standard normal.
        observation_noise: Standard normal (B, C), or None.
        corruption: Draws that corrupt tokens, or None.
        latent: Standard normal (B, dim), or None.
    """

    time: Tensor
    source: dict[str, Tensor]
    observation_noise: Tensor | None = None
    corruption: TokenCorruption | None = None
    latent: Tensor | None = None


def draw_path_points(
    model: DualheadModel, like: Tensor, generator: torch.Generator
) -> tuple[Tensor, dict[str, Tensor]]:
    """Times (B,) and source noise by head (B, H, d) for actions ``like`` (B, H, D)."""
    config = model.config
    time = torch.rand(len(like), generator=generator, device=like.device).to(like.dtype)
    shape = (len(like), config.chunk_size)
    noise = coupled_source_noise(shape, model.head_dims, config.source_noise_beta, generator)
    return time, {head: value.to(like.dtype) for head, value in noise.items()}


def draw_step(
    model: DualheadModel,
    observation: Tensor,
    action: Tensor,
    *,
    seed: int,
    step: int,
    rank: int = 0,
    has_tokens: bool,
) -> StepDraws:
    """The draws of training step ``step`` of a run, or of its validation where the model is in evaluation mode.

    Args:
        model: The model; its configuration says what is drawn.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D).
        seed: Seed of the run.
        step: Training step.
        rank: Process of a distributed training; each draws its own.
        has_tokens: Whether the windows come with tokens.
    """
    config, device = model.config, action.device
    key = step_key(seed, step, "train" if model.training else "validate", rank)
    generator = keyed_generator(*key, device=device)
    time, source = draw_path_points(model, action, generator)
    noise = corruption = latent = None
    if config.observation_noise and model.training:
        own = keyed_generator(*key, "observation", device=device)
        noise = torch.randn(observation.shape, generator=own, device=device).to(observation.dtype)
    if has_tokens and model.tokens is not None and (config.token_replacement_prob or config.token_null_prob):
        corruption = model.tokens.draw_corruption((len(action),), generator)
    if model.shared_latent is not None:
        own = keyed_generator(*key, "latent", device=device)
        latent = model.shared_latent.draw((len(action),), own).to(action.dtype)
    return StepDraws(time, source, noise, corruption, latent)


@dataclass(frozen=True)
class NoisyChunks:
    """One point of every head's interpolation path, in the heads' frames, flattened.

    Attributes:
        time: t (B,), the same for all heads.
        source, target: y_0 and y_1 by head, each (B, H * d).
    """

    time: Tensor
    source: dict[str, Tensor]
    target: dict[str, Tensor]

    def at_time(self, head: str) -> Tensor:
        """y_t (B, H * d)."""
        return interpolate(self.source[head], self.target[head], self.time)


def noisy_chunks(
    model: DualheadModel, observation: Tensor, action: Tensor, time: Tensor, source: dict[str, Tensor]
) -> NoisyChunks:
    """Windows (B, H, D) in physical units and their noise, taken into the heads' frames."""
    normalized = model.action_scale.normalize(action)
    start, end = {}, {}
    for head, part in model.head_slices.items():
        start[head], end[head] = source[head].flatten(1), normalized[..., part].flatten(1)
        if head in model.frames:
            start[head] = model.frame(head).rotate(start[head])
            end[head] = model.frame(head).enter(end[head], observation)
    return NoisyChunks(time, start, end)
