"""The range of observations that a policy was trained on, beyond which it does not extrapolate.

The mean of a chunk frame is linear in the observation. In closed loop an arm that has hit something can show
observations dozens of standard deviations away; targets that grow with them would drive the robot further out.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: How far beyond the training data an observation is still taken as it is, in standard deviations.
MARGIN = 1.0


class ObservationRange(nn.Module):
    """Smallest and largest preprocessed observation of the training windows, per dimension.

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
    def fit(self, observation: Tensor) -> None:
        """Fit to the training observations (N, C)."""
        self.low.copy_(observation.amin(dim=0))
        self.high.copy_(observation.amax(dim=0))

    def forward(self, observation: Tensor) -> Tensor:
        """Observations (..., C) moved into the range and its margin; those of the training data stay as they are."""
        return torch.minimum(torch.maximum(observation, self.low - MARGIN), self.high + MARGIN)
