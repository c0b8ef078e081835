"""The gripper's commands: a small deterministic output beside the heads, which the paper does not model."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

GRIPPER_WIDTH = 64


class GripperOutput(nn.Module):
    """Open or close, for every step of the chunk, from the observation alone.

    It has its own two layers on the preprocessed observation, so that its loss moves neither the shared encoder nor a
    head, and it takes no part in what the heads share.

    Args:
        observation_dim: Size of the preprocessed observation.
        chunk_size: H.
    """

    def __init__(self, observation_dim: int, chunk_size: int):
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(observation_dim, GRIPPER_WIDTH),
            nn.SiLU(),
            nn.Linear(GRIPPER_WIDTH, GRIPPER_WIDTH),
            nn.SiLU(),
            nn.Linear(GRIPPER_WIDTH, chunk_size),
        )

    def loss(self, observation: Tensor, command: Tensor) -> Tensor:
        """Cross-entropy in nats of the demonstrated commands (B, H), -1 (open) or +1 (closed)."""
        return functional.binary_cross_entropy_with_logits(self.layers(observation), (command + 1) / 2)

    def commands(self, observation: Tensor) -> Tensor:
        """The likelier command of every step (B, H), -1 or +1."""
        return torch.where(self.layers(observation) > 0, 1.0, -1.0)
