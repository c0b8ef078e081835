"""Scale of the dual action vector, kept inside the policy.

The heads learn in normalised units; everything that leaves the policy is in physical units (rad, m). The
buffers travel in ``model.safetensors``, so that a loaded policy needs no dataset.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn


class ActionScale(nn.Module):
    """Affine scale per dimension: normalised = (physical - shift) / scale.

    Buffers, each (D,):
        shift, scale: The affine map; identity where normalisation is off. Rotations are never normalised.
        spread: Root mean square of the normalised training data, per dimension: the scale of the Gaussian
            that preconditions the velocity fields. Zero for a dimension that is constantly zero.
    """

    shift: Tensor
    scale: Tensor
    spread: Tensor

    def __init__(self, dim: int):
        super().__init__()
        self.register_buffer("shift", torch.zeros(dim))
        self.register_buffer("scale", torch.ones(dim))
        self.register_buffer("spread", torch.ones(dim))

    @torch.no_grad()
    def fit(self, stats: Mapping[str, Mapping[str, Any]], *, normalized: list[bool], std_floor: float) -> ActionScale:
        """Set the buffers from a dataset's statistics.

        Args:
            stats: LeRobot statistics; ``stats["action"]`` needs ``mean`` and ``std``.
            normalized: Which dimensions to normalise by mean and standard deviation, length D.
            std_floor: A standard deviation below this counts as 1 (constant dimensions stay at rest).

        Raises:
            ValueError: If the statistics are missing, of another width or not finite.
        """
        moments = []
        for name in ("mean", "std"):
            value = stats.get("action", {}).get(name)
            if value is None:
                raise ValueError(
                    f"the dataset's statistics lack 'action' {name}: expected meta/stats.json with mean and std "
                    "for every feature; record the dataset again"
                )
            value = torch.as_tensor(value, dtype=torch.float64).flatten()
            if value.shape != self.shift.shape or not torch.isfinite(value).all():
                raise ValueError(
                    f"the dataset's statistics of 'action' {name} have {value.numel()} values, expected "
                    f"{self.shift.numel()} finite ones: record the dataset again"
                )
            moments.append(value)
        mean, std = moments
        use = torch.tensor(normalized)
        shift = torch.where(use, mean, 0)
        scale = torch.where(use & (std >= std_floor), std, 1)
        self.shift.copy_(shift)
        self.scale.copy_(scale)
        spread = (std.square() + (mean - shift).square()).sqrt() / scale
        self.spread.copy_(torch.where(spread >= std_floor, spread, 0))
        return self

    def normalize(self, action: Tensor) -> Tensor:
        """Physical (..., D) to normalised units."""
        return (action - self.shift) / self.scale

    def unnormalize(self, value: Tensor, part: slice) -> Tensor:
        """Normalised values (..., d) of the dimensions ``part`` back to physical units."""
        return value * self.scale[part] + self.shift[part]
