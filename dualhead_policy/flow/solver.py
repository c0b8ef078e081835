"""The solver: integrates the heads' velocity fields from noise to chunks, many samples per condition at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from dualhead_policy.flow.coupling import SharedDraws, resolve_shared_draws, resolve_source_noise
from dualhead_policy.flow.flow_matching import integrate_within
from dualhead_policy.kinematics.rotation6d import columns_from_matrix, matrix_from_columns
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.sampling import HeadSamples, SamplingCoupling

#: Rows integrated together: small enough for the activations to stay in cache.
SAMPLING_ROWS = 2048


def sample_chunks(
    model: DualheadModel,
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
    embedding = model.embed(observation)
    shape = (*leading, model.config.chunk_size)
    source = resolve_source_noise(coupling, shape, model.head_dims, model.config.source_noise_beta, generator)
    shared = _shared_draws(model, embedding, num_samples, coupling, generator)
    per_chunk = max(1, SAMPLING_ROWS // num_samples)
    heads: dict[str, Tensor] = {}
    diverged = torch.zeros(leading, dtype=torch.bool, device=observation.device)
    for head in model.head_slices:
        noise = source[head].to(observation.device).flatten(2)
        pieces = []
        for start in range(0, len(observation), per_chunk):
            rows = slice(start, start + per_chunk)
            piece, held = _integrate(model, head, noise[rows], embedding[rows], shared[head], rows, num_steps)
            pieces.append(piece)
            diverged[rows] |= held
        heads[head] = model.physical_chunk(head, torch.cat(pieces), observation)
    rotation = heads.get("rotation")
    return HeadSamples(
        heads["joint"],
        heads["position"],
        rotation=None if rotation is None else columns_from_matrix(matrix_from_columns(rotation)),
        token=shared["joint"].token,
        latent=shared["joint"].latent,
        gripper=None if model.gripper is None else model.gripper.commands(observation),
        diverged=diverged,
    )


def _shared_draws(
    model: DualheadModel,
    embedding: Tensor,
    num_samples: int,
    coupling: SamplingCoupling,
    generator: torch.Generator | None,
) -> dict[str, SharedDraws]:
    def token() -> Tensor:
        return model.draw_tokens(embedding, num_samples, generator)

    def latent() -> Tensor:
        assert model.shared_latent is not None
        return model.shared_latent.draw((len(embedding), num_samples), generator)

    shared = resolve_shared_draws(
        coupling,
        list(model.head_slices),
        None if model.tokens is None else token,
        None if model.shared_latent is None else latent,
    )
    return {
        head: SharedDraws(
            None if draws.token is None else draws.token.to(embedding.device),
            None if draws.latent is None else draws.latent.to(embedding),
        )
        for head, draws in shared.items()
    }


def _integrate(
    model: DualheadModel,
    head: str,
    noise: Tensor,
    embedding: Tensor,
    shared: SharedDraws,
    rows: slice,
    num_steps: int,
) -> tuple[Tensor, Tensor]:
    """Integrate noise (B, N, H * d) of some rows; embedding (B, ...) is theirs, ``shared`` is of all rows.

    Returns clean chunks (B, N, H * d) in the head's frame, and which of them had to be held to its range (B, N).
    """
    if model.frames:
        noise = model.frame(head).rotate(noise)
    token = None
    if shared.token is not None:
        assert model.tokens is not None
        # The conditioning is computed once per condition and token, not once per sample.
        every = torch.arange(model.tokens.n_tokens, device=noise.device)
        context = model.context(embedding, token=every.expand(len(noise), -1))
        token = shared.token[rows]
    elif shared.latent is not None:
        context = model.context(embedding, latent=shared.latent[rows])
    else:
        context = model.context(embedding)[:, None]
    index = torch.arange(len(noise), device=noise.device)[:, None]
    spread = model.spread(head)

    def velocity(x: Tensor, time: float) -> Tensor:
        now = torch.tensor(time, device=x.device)
        modulation = model.network.modulation(head, now, context)
        if token is not None:
            modulation = [part[index, token] for part in modulation]
        return model.network.velocity(head, x, now, modulation, spread)

    return integrate_within(velocity, noise, num_steps, *model.endpoint_range(head).bounds())


def numpy_field(field: Callable[[Tensor, float], Tensor], like: Tensor) -> Callable[[np.ndarray, float], np.ndarray]:
    """A velocity field on NumPy arrays, computed on the device and in the precision of ``like``."""

    @torch.no_grad()
    def velocity(x: np.ndarray, time: float) -> np.ndarray:
        return field(torch.from_numpy(np.asarray(x)).to(like), time).cpu().numpy()

    return velocity


def condition_velocity(
    model: DualheadModel, observation: Tensor, head: str, shared: SharedDraws
) -> Callable[[Tensor, float], Tensor]:
    """A head's velocity field under given conditions, in the coordinates of its source noise.

    The walk from noise along it ends where :func:`sample_chunks` does. In these coordinates, the normalised action's
    own axes less a mean that does not move, the fields of policies with different frames can be compared.

    Args:
        model: The model.
        observation: Preprocessed observations (N, C).
        head: ``"joint"``, ``"position"`` or ``"rotation"``.
        shared: Token (N,) or latent (N, dim) of every row.

    Returns:
        A function of states (N, H, d) and a time in [0, 1) to velocities (N, H, d).
    """
    context = model.context(model.embed(observation), shared.token, shared.latent)
    frame = model.frame(head) if model.frames else None

    def velocity(x: Tensor, time: float) -> Tensor:
        y = x.flatten(1)
        y = y if frame is None else frame.rotate(y)
        moved = model.velocity(head, y, torch.full((len(y),), time, dtype=y.dtype, device=y.device), context)
        moved = moved if frame is None else moved @ frame.basis.T
        return moved.unflatten(1, x.shape[1:])

    return velocity
