"""The learned categorical prior of tokens given the observation (family I of tab:main)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

PRIOR_WIDTH = 64


class TokenPrior(nn.Module):
    """p(k | c), from the condition's embedding, to which it sends no gradient: the heads train as without it.

    Args:
        embedding_dim: Size of E(c).
        n_tokens: Number of tokens.
    """

    def __init__(self, embedding_dim: int, n_tokens: int):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(embedding_dim, PRIOR_WIDTH), nn.SiLU(), nn.Linear(PRIOR_WIDTH, n_tokens))

    def loss(self, embedding: Tensor, token: Tensor) -> Tensor:
        """Cross-entropy in nats of clean tokens (B,) given embeddings (B, ...)."""
        return functional.cross_entropy(self.layers(embedding.detach()), token)

    def probabilities(self, embedding: Tensor) -> Tensor:
        """p(k | c) (B, n_tokens) given embeddings (B, ...)."""
        return self.layers(embedding).softmax(dim=-1)

    def draw(self, embedding: Tensor, num_samples: int, generator: torch.Generator | None) -> Tensor:
        """Tokens (B, num_samples) given embeddings (B, ...), on the generator's device."""
        device = generator.device if generator is not None else torch.device("cpu")
        weights = self.probabilities(embedding).to(device)
        return torch.multinomial(weights, num_samples, replacement=True, generator=generator)
