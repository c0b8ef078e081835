"""The random part of corrupting tokens in training, apart from the tokens: nothing but torch, for any process."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class TokenCorruption:
    """Draws that decide which tokens are corrupted: a uniform ``chance`` and a random ``replacement``, each (B,)."""

    chance: Tensor
    replacement: Tensor

    def to(self, device: torch.device) -> TokenCorruption:
        """The same draws on another device."""
        return TokenCorruption(self.chance.to(device), self.replacement.to(device))


def draw_corruption(shape: tuple[int, ...], n_tokens: int, generator: torch.Generator) -> TokenCorruption:
    """The draws of :meth:`TokenTable.corrupt` for tokens of ``shape``, on the CPU."""
    chance = torch.rand(shape, generator=generator)
    return TokenCorruption(chance, torch.randint(n_tokens, shape, generator=generator))
