"""The random draws of a training step, apart from the loss that they enter.

They are a function of (seed, step, purpose): time, source noise and token corruption come from one keyed generator,
latents and observation noise from their own, so that a mechanism leaves the draws of the others as they are, and runs
that train side by side draw what each would have drawn alone. They are made on the CPU and moved to where they are
needed: a run draws the same on every device.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dualhead_policy.flow.draw_rule import DrawRule, StepDraws
from dualhead_policy.flow.flow_matching import coupled_source_noise, interpolate
from dualhead_policy.flow.noise_alignment import own_alignment
from dualhead_policy.model.dualhead_model import DualheadModel


def draw_path_points(
    model: DualheadModel, like: Tensor, generator: torch.Generator
) -> tuple[Tensor, dict[str, Tensor]]:
    """Times (B,) and source noise by head (B, H, d) for actions ``like`` (B, H, D), drawn on the CPU."""
    config = model.config
    time = torch.rand(len(like), generator=generator).to(like)
    shape = (len(like), config.chunk_size)
    noise = coupled_source_noise(
        shape, model.head_dims, config.source_noise_beta, generator, config.private_noise_heads, own_alignment(model)
    )
    return time, {head: value.to(like) for head, value in noise.items()}


def draw_rule(model: DualheadModel, observation_dim: int, *, seed: int, has_tokens: bool) -> DrawRule:
    """What the steps of a model's training draw, or of its validation where it is in evaluation mode.

    Args:
        model: The model; its configuration says what is drawn.
        observation_dim: Size C of the observation.
        seed: Seed of the run.
        has_tokens: Whether the windows come with tokens.
    """
    config, tokens = model.config, model.tokens
    corrupted = has_tokens and tokens is not None and (config.token_replacement_prob or config.token_null_prob)
    return DrawRule(
        seed,
        config.chunk_size,
        dict(model.head_dims),
        config.source_noise_beta,
        config.private_noise_heads,
        observation_dim if config.observation_noise and model.training else 0,
        tokens.n_tokens if tokens is not None and corrupted else 0,
        None if model.shared_latent is None else model.shared_latent.dim,
        own_alignment(model),
    )


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

    Returns:
        The draws, of the windows' type and on their device.
    """
    rule = draw_rule(model, observation.shape[1], seed=seed, has_tokens=has_tokens)
    draws = rule.draw(len(action), step, "train" if model.training else "validate", rank)
    return StepDraws(
        draws.time.to(action),
        {head: value.to(action) for head, value in draws.source.items()},
        None if draws.observation_noise is None else draws.observation_noise.to(observation),
        None if draws.corruption is None else draws.corruption.to(action.device),
        None if draws.latent is None else draws.latent.to(action),
    )


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
