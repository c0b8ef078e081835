"""The continuous latent that both heads may see (families C, D and E of tab:main)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

#: Width of the latent's code, appended to the condition's embedding (sec:models).
CODE_DIM = 32
#: Hidden units of the posterior's network.
POSTERIOR_WIDTH = 256


class SharedLatent(nn.Module):
    """z, drawn from a standard normal at sampling, and its code; in training z may come from a posterior.

    Args:
        dim: Dimensions of z; 0 is the anchor, whose code is zero.
        posterior_inputs: Size of what an amortised posterior q(z | x_1, c) sees, or 0 for none.
    """

    def __init__(self, dim: int, posterior_inputs: int):
        super().__init__()
        self.dim = dim
        self.code = nn.Sequential(nn.Linear(dim, CODE_DIM), nn.SiLU()) if dim else None
        self.posterior: nn.Sequential | None = None
        if posterior_inputs:
            self.posterior = nn.Sequential(
                nn.Linear(posterior_inputs, POSTERIOR_WIDTH),
                nn.SiLU(),
                nn.Linear(POSTERIOR_WIDTH, POSTERIOR_WIDTH),
                nn.SiLU(),
                nn.Linear(POSTERIOR_WIDTH, 2 * dim),
            )

    def draw(self, shape: tuple[int, ...], generator: torch.Generator | None) -> Tensor:
        """z (*shape, dim) from the standard normal."""
        device = generator.device if generator is not None else torch.device("cpu")
        return torch.randn(*shape, self.dim, generator=generator, device=device)

    def encode(self, latent: Tensor) -> Tensor:
        """The code (..., 32) of z (..., dim)."""
        if self.code is None:
            return latent.new_zeros(*latent.shape[:-1], CODE_DIM)
        return self.code(latent)

    def infer(self, chunk: Tensor, embedding: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation (B, dim) of q(z | x_1, c).

        Args:
            chunk: Flattened normalised chunks of all heads (B, ...).
            embedding: E(c), (B, ...).
        """
        assert self.posterior is not None
        mean, raw = self.posterior(torch.cat([chunk, embedding], dim=-1)).chunk(2, dim=-1)
        return mean, functional.softplus(raw) + 1e-4


def divergence_from_standard_normal(mean: Tensor, deviation: Tensor) -> Tensor:
    """KL(N(mean, deviation^2) || N(0, 1)) in nats, per dimension (..., dim)."""
    return 0.5 * (mean.square() + deviation.square() - 1) - deviation.log()


def free_bits_penalty(divergence: Tensor, free_bits: float | Tensor) -> Tensor:
    """Sum over dimensions of the batch's mean divergence (B, dim), each at least ``free_bits`` nats.

    Below its free bits a dimension has no gradient (Kingma et al. 2016).
    """
    return divergence.mean(dim=0).clamp(min=free_bits).sum()
