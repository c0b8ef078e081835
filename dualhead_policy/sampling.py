"""The sampling interface: what evaluation, residuals and monitors ask of a policy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor


@dataclass(frozen=True)
class HeadSamples:
    """Chunks sampled for B conditions, N per condition and head, in physical units.

    Attributes:
        joint: Head A (B, N, H, d_A): rad on robots, the chosen representation on the ring.
        position: Head B (B, N, H, d): m, in the frame of the environment's layout.
        rotation: Third head (B, N, H, 6): first two columns of the rotation matrix, or None.
        token: Shared token (B, N), or None for a policy without one.
        latent: Shared latent (B, N, dim), or None for a policy without one.
        gripper: The policy's gripper commands (B, H), -1 (open) or +1 (closed), or None without a gripper.
        diverged: Whether the flow of either head had to be held to the range of the training chunks (B, N), or None
            for a sampler that cannot diverge.
    """

    joint: Tensor
    position: Tensor
    rotation: Tensor | None = None
    token: Tensor | None = None
    latent: Tensor | None = None
    gripper: Tensor | None = None
    diverged: Tensor | None = None


#: Distributions of tokens in sampling.
TOKEN_DRAWS = ("uniform", "marginal", "learned")
#: How heads of different width can share source noise, other than coordinate by coordinate.
NOISE_ALIGNMENTS = ("kinematic",)


@dataclass(frozen=True)
class SamplingCoupling:
    """What the heads share while sampling; every field left at None means the policy's own choice.

    Attributes:
        source_noise_beta: beta of sec:heads; 1 private noise, 0 shared noise.
        source_noise: The noise itself by head (``"joint"``, ``"position"`` and, where there is one, ``"rotation"``),
            each (B, N, H, d); overrides beta. Passing one member's noise to another couples an ensemble.
        source_noise_alignment: ``"kinematic"``: shared noise goes from the joint head to the others through the
            kinematic map (:mod:`dualhead_policy.flow.noise_alignment`), not coordinate by coordinate.
        token: Tokens (B, N) to use instead of drawing them.
        token_draw: Distribution of drawn tokens: ``"uniform"``, ``"marginal"`` or, for a policy that has one,
            ``"learned"``. The prior sends the heads no gradient, so that this too is a question to the sampler alone.
        share_token: Whether the heads follow one token; False draws another one for every further head.
        latent: Latents (B, N, dim) to use instead of drawing them.
        share_latent: Whether the heads follow one latent; False draws another one for every further head.
    """

    source_noise_beta: float | None = None
    source_noise: Mapping[str, Tensor] | None = None
    source_noise_alignment: str | None = None
    token: Tensor | None = None
    token_draw: str | None = None
    share_token: bool = True
    latent: Tensor | None = None
    share_latent: bool = True


class Sampler(Protocol):
    """Anything that samples both heads: a trained policy, or the exact reference."""

    def sample(
        self,
        batch: Mapping[str, Tensor],
        num_samples: int,
        *,
        num_steps: int | None = None,
        coupling: SamplingCoupling | None = None,
        generator: torch.Generator | None = None,
    ) -> HeadSamples:
        """Sample ``num_samples`` chunks per condition and head, in ``num_steps`` Euler steps."""
        ...


def refuse_keywords(method: str, given: Mapping[str, Any]) -> None:
    """Refuse what LeRobot passes to other policies' closed loop, such as one source noise for all heads.

    Raises:
        ValueError: If any of the keyword arguments is not None.
    """
    for name, value in given.items():
        if value is not None:
            raise ValueError(
                f"{method} got {name}=..., which a dualhead policy does not take: expected a batch alone; to choose "
                "the noise of each head, call policy.sample(batch, 1, coupling=SamplingCoupling(source_noise=...))"
            )
