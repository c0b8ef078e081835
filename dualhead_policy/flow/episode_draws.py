"""What the heads of a policy in closed loop share through an episode, drawn at its first decision and held."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from dualhead_policy.kinematics.rotation6d import columns_from_matrix
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.sampling import HeadSamples, SamplingCoupling


@dataclass
class EpisodeDraws:
    """The draws of B episodes that run side by side; a batch of another size draws anew.

    Attributes:
        token: Tokens (B, 1), or None before the first decision and without tokens.
        latent: Latents (B, 1, dim), likewise.
        rotation: The start orientation (B, 6), for policies without a rotation head.
    """

    token: Tensor | None = None
    latent: Tensor | None = None
    rotation: Tensor | None = None

    def coupling(self, model: DualheadModel, observation: Tensor) -> SamplingCoupling:
        """The draws for preprocessed observations (B, C); window tokens belong to a window and are never held."""
        n = len(observation)
        if model.tokens is not None and (self.token is None or len(self.token) != n or model.config.token == "window"):
            self.token = model.draw_tokens(model.embed(observation), 1, None)
        if model.shared_latent is not None and (self.latent is None or len(self.latent) != n):
            self.latent = model.shared_latent.draw((n, 1), None)
        return SamplingCoupling(token=self.token, latent=self.latent)

    def orientation(self, model: DualheadModel, samples: HeadSamples) -> Tensor:
        """The held orientation of every step (B, H, 6): that of the first joint configuration predicted."""
        first = samples.joint[:, 0, 0]
        if self.rotation is None or len(self.rotation) != len(first):
            self.rotation = columns_from_matrix(model.kinematics.rotation(first))
        return self.rotation[:, None].expand(-1, model.config.chunk_size, -1)
