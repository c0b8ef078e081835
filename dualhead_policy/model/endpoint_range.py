"""The range of clean chunks that a head was trained on, within which the endpoints of its flow are held."""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: How far beyond the training chunks an endpoint may lie, in widths of their range.
MARGIN = 0.5


class EndpointRange(nn.Module):
    """Smallest and largest training chunk of a head, per coordinate in which its velocity field works.

    The population optimum's clean endpoint x_t + (1 - t) v is a conditional mean of training chunks and lies between
    the two. A trained field's need not: far from its data the gain of its modulated layers can exceed one per step,
    and twenty steps multiply it (measured: chunks of 1e26 under biased joint encoders). With endpoints held to the
    range, each Euler step moves towards a point inside it, so samples stay bounded for any observation.

    Buffers:
        low, high (H * d,): The range, without the margin; infinite until fitted.
    """

    low: Tensor
    high: Tensor

    def __init__(self, chunk_dim: int):
        super().__init__()
        self.register_buffer("low", torch.full((chunk_dim,), -torch.inf))
        self.register_buffer("high", torch.full((chunk_dim,), torch.inf))

    @torch.no_grad()
    def fit(self, low: Tensor, high: Tensor) -> None:
        """Set the range to the smallest and largest training chunk (H * d,)."""
        self.low.copy_(low)
        self.high.copy_(high)

    def bounds(self) -> tuple[Tensor, Tensor]:
        """The range with its margin, two tensors (H * d,)."""
        margin = MARGIN * (self.high - self.low)
        return self.low - margin, self.high + margin
