"""What a training step draws, without the model that it trains: nothing but torch, so that any process can draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from dualhead_policy.flow.flow_matching import coupled_source_noise
from dualhead_policy.flow.keyed_random import keyed_generator, step_key
from dualhead_policy.model.token_corruption import TokenCorruption, draw_corruption


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


@dataclass(frozen=True)
class DrawRule:
    """What the steps of one run draw, without its model: it can be sent to another process.

    Attributes:
        seed: Seed of the run.
        chunk_size: H.
        head_dims: Dimensions d of each head's space, by head.
        source_noise_beta: Coupling of the heads' source noise.
        private_noise_heads: Heads whose noise is their own whatever that coupling.
        observation_dim: Size C of the observation noise, 0 for none.
        n_tokens: Tokens among which a corrupted one is drawn, 0 for none.
        latent_dim: Dimensions of the latent, or None for none.
        aligned: What carries the shared noise to heads that do not take its first coordinates, by head, or None.
    """

    seed: int
    chunk_size: int
    head_dims: Mapping[str, int]
    source_noise_beta: float
    private_noise_heads: tuple[str, ...]
    observation_dim: int
    n_tokens: int
    latent_dim: int | None
    aligned: Mapping[str, Tensor] | None = field(default=None, compare=False)

    def draw(self, batch: int, step: int, purpose: str = "train", rank: int = 0) -> StepDraws:
        """The draws of ``batch`` windows at training step ``step``, in float32 on the CPU.

        Args:
            batch: Windows B.
            step: Training step.
            purpose: ``"train"`` or ``"validate"``.
            rank: Process of a distributed training; each draws its own.
        """
        key = step_key(self.seed, step, purpose, rank)
        generator = keyed_generator(*key)
        time = torch.rand(batch, generator=generator)
        shape = (batch, self.chunk_size)
        source = coupled_source_noise(
            shape, self.head_dims, self.source_noise_beta, generator, self.private_noise_heads, self.aligned
        )
        noise = corruption = latent = None
        if self.observation_dim:
            noise = torch.randn(batch, self.observation_dim, generator=keyed_generator(*key, "observation"))
        if self.n_tokens:
            corruption = draw_corruption((batch,), self.n_tokens, generator)
        if self.latent_dim is not None:
            latent = torch.randn(batch, self.latent_dim, generator=keyed_generator(*key, "latent"))
        return StepDraws(time, source, noise, corruption, latent)
