"""The range of observations that a policy was trained on, beyond which it does not extrapolate.

Networks, and the mean of a chunk frame, grow with the observation. In closed loop an arm that has hit something can
show observations dozens of standard deviations away; targets that grow with them would drive the robot further out.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: How far beyond the training data an observation is still taken as it is, in standard deviations.
MARGIN = 1.0


class ObservationRange(nn.Module):
    """Smallest and largest preprocessed observation of the training data, per dimension.

    Buffers:
        low, high (C,): The range, without the margin.
    """

    low: Tensor
    high: Tensor

    def __init__(self, observation_dim: int):
        super().__init__()
        self.register_buffer("low", torch.full((observation_dim,), -torch.inf))
        self.register_buffer("high", torch.full((observation_dim,), torch.inf))

    @torch.no_grad()
    def fit(self, low: Tensor, high: Tensor) -> None:
        """Set the range to the smallest and largest training observation (C,)."""
        self.low.copy_(low)
        self.high.copy_(high)

    def forward(self, observation: Tensor) -> Tensor:
        """Observations (..., C) moved into the range and its margin; those of the training data stay as they are."""
        return torch.minimum(torch.maximum(observation, self.low - MARGIN), self.high + MARGIN)
