"""Integrate the heads' velocity fields from noise to chunks, for many samples of a condition at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from dualhead_policy.flow.flow_matching import coupled_source_noise, integrate_euler
from dualhead_policy.kinematics.rotation6d import columns_from_matrix, matrix_from_columns
from dualhead_policy.sampling import HeadSamples, SamplingCoupling

if TYPE_CHECKING:
    from dualhead_policy.modeling_dualhead import DualheadPolicy

#: Rows integrated together: small enough for the activations to stay in cache.
SAMPLING_ROWS = 2048


@dataclass(frozen=True)
class SharedDraws:
    """What a head's samples follow: tokens (B, N), or latents (B, N, dim), or neither."""

    token: Tensor | None = None
    latent: Tensor | None = None


def sample_chunks(
    policy: DualheadPolicy,
    observation: Tensor,
    num_samples: int,
    num_steps: int,
    coupling: SamplingCoupling,
    generator: torch.Generator | None,
) -> HeadSamples:
    """Chunks of every head for preprocessed observations (B, C); see ``DualheadPolicy.sample``.

    Draws are made in this order: source noise, then tokens or latents, then those of further heads that do not share.
    """
    leading = (len(observation), num_samples)
    embedding = policy.network.encoder(observation)
    source = _source_noise(policy, leading, coupling, generator)
    shared = _shared_draws(policy, embedding, num_samples, coupling, generator)
    per_chunk = max(1, SAMPLING_ROWS // num_samples)
    heads: dict[str, Tensor] = {}
    for head in policy.head_slices:
        noise = source[head].to(observation.device).flatten(2)
        pieces = []
        for start in range(0, len(observation), per_chunk):
            rows = slice(start, start + per_chunk)
            pieces.append(_integrate(policy, head, noise[rows], embedding[rows], shared[head], rows, num_steps))
        heads[head] = policy.physical_chunk(head, torch.cat(pieces), observation)
    rotation = heads.get("rotation")
    return HeadSamples(
        heads["joint"],
        heads["position"],
        rotation=None if rotation is None else columns_from_matrix(matrix_from_columns(rotation)),
        token=shared["joint"].token,
        latent=shared["joint"].latent,
        gripper=None if policy.gripper is None else policy.gripper.commands(observation),
    )


def _source_noise(
    policy: DualheadPolicy, leading: tuple[int, int], coupling: SamplingCoupling, generator: torch.Generator | None
) -> Mapping[str, Tensor]:
    if coupling.source_noise:
        missing = sorted(set(policy.head_dims) - set(coupling.source_noise))
        if missing:
            raise ValueError(f"coupling.source_noise lacks {missing}: give the noise of every head")
        return coupling.source_noise
    beta = coupling.source_noise_beta
    beta = policy.config.source_noise_beta if beta is None else beta
    return coupled_source_noise((*leading, policy.config.chunk_size), policy.head_dims, beta, generator)


def _shared_draws(
    policy: DualheadPolicy,
    embedding: Tensor,
    num_samples: int,
    coupling: SamplingCoupling,
    generator: torch.Generator | None,
) -> dict[str, SharedDraws]:
    """What each head's samples follow; the first head's are the caller's, where it gave any."""
    if coupling.token is not None and policy.tokens is None:
        raise ValueError("the policy has no token to follow: sample it without coupling.token")
    if coupling.latent is not None and policy.shared_latent is None:
        raise ValueError("the policy has no latent to follow: sample it without coupling.latent")

    def draw(given: SamplingCoupling | None) -> SharedDraws:
        token = latent = None
        if policy.tokens is not None:
            token = given.token if given is not None else None
            token = policy.tokens_given(embedding, num_samples, generator) if token is None else token
            token = token.to(embedding.device)
        if policy.shared_latent is not None:
            latent = given.latent if given is not None else None
            if latent is None:
                latent = policy.shared_latent.draw((len(embedding), num_samples), generator)
            latent = latent.to(embedding)
        return SharedDraws(token, latent)

    first = draw(coupling)
    apart = (policy.tokens is not None and not coupling.share_token) or (
        policy.shared_latent is not None and not coupling.share_latent
    )
    return {head: first if index == 0 or not apart else draw(None) for index, head in enumerate(policy.head_slices)}


def _integrate(
    policy: DualheadPolicy,
    head: str,
    noise: Tensor,
    embedding: Tensor,
    shared: SharedDraws,
    rows: slice,
    num_steps: int,
) -> Tensor:
    """Integrate noise (B, N, H * d) of some rows; embedding (B, ...) is theirs, ``shared`` is of all rows."""
    if policy.frames:
        noise = policy.frame(head).rotate(noise)
    context = embedding[:, None]
    token: Tensor | None = None
    if shared.token is not None:
        assert policy.tokens is not None
        # The conditioning is computed once per condition and token, not once per sample.
        codes = policy.tokens.one_hot(torch.arange(policy.tokens.n_tokens, device=noise.device))
        context = _pairwise(embedding, codes.expand(len(noise), -1, -1))
        token = shared.token[rows]
    elif shared.latent is not None:
        assert policy.shared_latent is not None
        context = _pairwise(embedding, policy.shared_latent.encode(shared.latent[rows]))
    index = torch.arange(len(noise), device=noise.device)[:, None]
    spread = policy.spread(head)

    def velocity(x: Tensor, time: float) -> Tensor:
        now = torch.tensor(time, device=x.device)
        modulation = policy.network.modulation(head, now, context)
        if token is not None:
            modulation = [part[index, token] for part in modulation]
        return policy.network.velocity(head, x, now, modulation, spread)

    return integrate_euler(velocity, noise, num_steps)


def condition_velocity(
    policy: DualheadPolicy, observation: Tensor, head: str, shared: SharedDraws
) -> Callable[[Tensor, float], Tensor]:
    """A head's velocity field under given conditions, in the coordinates of its source noise.

    The walk from noise along it ends where :func:`sample_chunks` does. In these coordinates, the normalised action's
    own axes less a mean that does not move, the fields of policies with different frames can be compared.

    Args:
        policy: The policy.
        observation: Preprocessed observations (N, C).
        head: ``"joint"``, ``"position"`` or ``"rotation"``.
        shared: Token (N,) or latent (N, dim) of every row.

    Returns:
        A function of states (N, H, d) and a time in [0, 1) to velocities (N, H, d).
    """
    context = policy.network.encoder(observation)
    if shared.token is not None:
        assert policy.tokens is not None
        context = torch.cat([context, policy.tokens.one_hot(shared.token)], dim=-1)
    elif shared.latent is not None:
        assert policy.shared_latent is not None
        context = torch.cat([context, policy.shared_latent.encode(shared.latent)], dim=-1)
    frame = policy.frame(head) if policy.frames else None

    def velocity(x: Tensor, time: float) -> Tensor:
        y = x.flatten(1)
        y = y if frame is None else frame.rotate(y)
        moved = policy.head_velocity(head, y, torch.full((len(y),), time, dtype=y.dtype, device=y.device), context)
        moved = moved if frame is None else moved @ frame.basis.T
        return moved.unflatten(1, x.shape[1:])

    return velocity


def _pairwise(embedding: Tensor, code: Tensor) -> Tensor:
    """Contexts (B, T, C + c) of embeddings (B, C) and codes (B, T, c)."""
    return torch.cat([embedding[:, None].expand(-1, code.shape[1], -1), code], dim=-1)
