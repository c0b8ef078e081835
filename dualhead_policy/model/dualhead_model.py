"""The dual-head model: encoder, velocity fields, scales, tokens and latent, without LeRobot around it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.model.action_scale import ActionScale
from dualhead_policy.model.chunk_frame import ChunkFrame
from dualhead_policy.model.endpoint_range import EndpointRange
from dualhead_policy.model.gripper import GripperOutput
from dualhead_policy.model.latent import CODE_DIM, SharedLatent
from dualhead_policy.model.network import DualheadNetwork
from dualhead_policy.model.observation_range import ObservationRange
from dualhead_policy.model.token_prior import TokenPrior
from dualhead_policy.model.tokens import TokenTable
from dualhead_policy.representation import RepresentationLayout

#: Names of the heads, in the order of the dual action vector; the third is optional.
HEADS = ("joint", "position", "rotation")


class DualheadModel(nn.Module):
    """Everything that a dual-head policy learns or fits; its state is the whole of ``model.safetensors``.

    Args:
        config: The configuration, with no field left open.
        layout: The dual action vector.
        observation_dim: Size C of the preprocessed observation.
        tokens: The shared tokens, or None.

    Attributes:
        head_slices: Where each head's dimensions lie in the dual action vector, by head: ``"joint"``,
            ``"position"`` and, with a third head, ``"rotation"``.
        head_dims: Dimensions d of each head's space.
        kinematics: Forward kinematics, from the joint head's space to the position head's.
    """

    def __init__(
        self, config: DualheadConfig, layout: RepresentationLayout, observation_dim: int, tokens: TokenTable | None
    ):
        super().__init__()
        self.config, self.layout = config, layout
        self.kinematics = KinematicMap(layout.kinematic_map)
        heads = HEADS if config.rotation_head else HEADS[:2]
        self.head_slices = {head: layout.slices[head] for head in heads}
        self.head_dims = {head: part.stop - part.start for head, part in self.head_slices.items()}
        chunk_dims = {head: config.chunk_size * dim for head, dim in self.head_dims.items()}
        framed = config.preconditioning == "linear_gaussian"
        self.action_scale = ActionScale(len(layout.names))
        self.frames = nn.ModuleDict({h: ChunkFrame(observation_dim, n) for h, n in chunk_dims.items() if framed})
        self.endpoint_ranges = nn.ModuleDict({head: EndpointRange(n) for head, n in chunk_dims.items()})
        self.observation_range = ObservationRange(observation_dim)
        self.tokens = tokens
        self.network = DualheadNetwork(
            observation_dim,
            self.head_dims,
            chunk_size=config.chunk_size,
            token_dim=tokens.n_tokens if tokens else CODE_DIM if config.latent else 0,
            encoder_dim=config.encoder_dim,
            width=config.velocity_width,
            n_layers=config.velocity_layers,
            n_frequencies=config.time_frequencies,
            conditioning=config.conditioning,
            preconditioned=config.preconditioning != "none",
            embedding_gain=config.embedding_gain or 1.0,
        )
        inferred = sum(chunk_dims.values()) + config.encoder_dim if config.latent == "posterior" else 0
        self.shared_latent = SharedLatent(config.latent_dim, inferred) if config.latent else None
        self.token_prior: TokenPrior | None = None
        if tokens is not None and config.token_draw == "learned":
            self.token_prior = TokenPrior(config.encoder_dim, tokens.n_tokens)
        self.gripper = GripperOutput(observation_dim, config.chunk_size) if layout.gripper else None

    @property
    def scales(self) -> nn.ModuleDict:
        """What is fitted to the training data: action scale, chunk frames, ranges of endpoints and observations."""
        return nn.ModuleDict(
            {
                "action_scale": self.action_scale,
                "frames": self.frames,
                "endpoint_ranges": self.endpoint_ranges,
                "observation_range": self.observation_range,
            }
        )

    # --- what the heads see ----------------------------------------------------------------------------------

    def observed(self, observation: Tensor) -> Tensor:
        """Preprocessed observations (B, C) as the model uses them: held to the training range."""
        return self.observation_range(observation)

    def embed(self, observation: Tensor) -> Tensor:
        """E(c), (B, encoder_dim), of observations (B, C)."""
        return self.network.encoder(observation)

    def context(self, embedding: Tensor, token: Tensor | None = None, latent: Tensor | None = None) -> Tensor:
        """What the velocity fields are conditioned on: E(c) and the code of the token or latent.

        Args:
            embedding: E(c) (B, E).
            token: Tokens (B,) or (B, T), for a model with tokens.
            latent: Latents (B, dim) or (B, T, dim), for a model with a latent.

        Returns:
            Contexts (B, E + c), or (B, T, E + c).
        """
        if token is not None:
            assert self.tokens is not None
            code = self.tokens.one_hot(token)
        elif latent is not None:
            assert self.shared_latent is not None
            code = self.shared_latent.encode(latent)
        else:
            return embedding
        if code.ndim > embedding.ndim:
            embedding = embedding[:, None].expand(-1, code.shape[1], -1)
        return torch.cat([embedding, code], dim=-1)

    def draw_tokens(
        self, embedding: Tensor, num_samples: int, generator: torch.Generator | None, draw: str | None = None
    ) -> Tensor:
        """Tokens (B, num_samples) given embeddings (B, E), as ``draw`` or else ``config.token_draw`` says.

        Raises:
            ValueError: If a prior is asked for that was not learned.
        """
        assert self.tokens is not None
        draw = draw or self.config.token_draw
        if draw != "learned":
            return self.tokens.draw((len(embedding), num_samples), draw, generator)
        if self.token_prior is None:
            raise ValueError(
                "the policy has learned no prior of its tokens: draw them uniform or marginal, or train it with "
                "--policy.token_draw=learned"
            )
        return self.token_prior.draw(embedding, num_samples, generator)

    def token_probabilities(self, embedding: Tensor) -> Tensor:
        """With which probabilities :meth:`draw_tokens` draws each token (B, n_tokens)."""
        assert self.tokens is not None
        if self.token_prior is not None:
            return self.token_prior.probabilities(embedding)
        uniform = self.config.token_draw == "uniform"
        one = torch.full_like(self.tokens.marginal, 1 / self.tokens.n_tokens) if uniform else self.tokens.marginal
        return one.expand(len(embedding), -1)

    # --- velocity and clean endpoint -------------------------------------------------------------------------

    def frame(self, head: str) -> ChunkFrame:
        """The frame of a head's chunks, for a model with linear_gaussian preconditioning."""
        frame = self.frames[head]
        assert isinstance(frame, ChunkFrame)
        return frame

    def endpoint_range(self, head: str) -> EndpointRange:
        """The range of a head's training chunks, in the coordinates in which its field works."""
        endpoints = self.endpoint_ranges[head]
        assert isinstance(endpoints, EndpointRange)
        return endpoints

    def spread(self, head: str) -> Tensor:
        """Standard deviations (H * d,) of the data in the coordinates in which the head's field works."""
        if head in self.frames:
            return self.frame(head).spread
        return self.action_scale.spread[self.head_slices[head]].repeat(self.config.chunk_size)

    def velocity(self, head: str, noisy: Tensor, time: Tensor, context: Tensor) -> Tensor:
        """Velocity (B, H * d) of a head at flattened noisy chunks y_t, times (B,) and contexts (B, ...)."""
        modulation = self.network.modulation(head, time, context)
        return self.network.velocity(head, noisy, time[:, None], modulation, self.spread(head))

    def clean_endpoint(self, head: str, noisy: Tensor, time: Tensor, velocity: Tensor, observation: Tensor) -> Tensor:
        """Where a straight path would end, a = y_t + (1 - t) v, as chunks (B, H, d) in physical units (eq:cons).

        Args:
            head: Name of the head.
            noisy, velocity: y_t and v, flattened, in the head's frame (B, H * d).
            time: t (B,).
            observation: Preprocessed observations (B, C).
        """
        return self.physical_chunk(head, noisy + (1 - time[:, None]) * velocity, observation)

    def physical_chunk(self, head: str, value: Tensor, observation: Tensor) -> Tensor:
        """Chunks (B, ..., H, d) in physical units of flattened clean chunks (B, ..., H * d) in the head's frame."""
        if head in self.frames:
            value = self.frame(head).leave(value, observation)
        chunk = value.unflatten(-1, (self.config.chunk_size, -1))
        return self.action_scale.unnormalize(chunk, self.head_slices[head])
