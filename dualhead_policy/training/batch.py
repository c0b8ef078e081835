"""A training batch."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Batch:
    """Preprocessed observations (B, C), dual action windows (B, H, D) and clean tokens (B,) or None."""

    observation: Tensor
    action: Tensor
    token: Tensor | None
