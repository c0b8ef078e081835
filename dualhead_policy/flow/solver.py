"""The solver: integrates the heads' velocity fields from noise to chunks, many samples per condition at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from dualhead_policy.flow.coupling import SharedDraws, resolve_shared_draws, resolve_source_noise
from dualhead_policy.flow.folded_field import FoldedField
from dualhead_policy.flow.noise_alignment import kinematic_alignment
from dualhead_policy.kinematics.rotation6d import columns_from_matrix, matrix_from_columns
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.sampling import HeadSamples, SamplingCoupling

#: Rows integrated together on a CPU: small enough for the activations to stay in cache.
SAMPLING_ROWS = 2048
#: Rows integrated together on an accelerator: enough to fill it, at a gigabyte of activations.
ACCELERATOR_SAMPLING_ROWS = 65_536
#: Rows from which a context is integrated alone, its modulation broadcast instead of gathered row by row.
ROWS_OF_ONE_CONTEXT = 128
#: Contexts times steps whose modulation is held at once.
FOLDED_CONTEXTS = 8192


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
    config = model.config
    source = resolve_source_noise(
        coupling,
        shape,
        model.head_dims,
        config.source_noise_beta,
        generator,
        config.private_noise_heads,
        lambda: kinematic_alignment(model),
        config.source_noise_alignment,
    )
    shared = _shared_draws(model, embedding, num_samples, coupling, generator)
    heads: dict[str, Tensor] = {}
    diverged = torch.zeros(leading, dtype=torch.bool, device=observation.device)
    for head in model.head_slices:
        noise = source[head].to(observation.device).flatten(2)
        clean, held = _clean_chunks(model, head, noise, embedding, shared[head], num_steps)
        diverged |= held
        heads[head] = model.physical_chunk(head, clean, observation)
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
        return model.draw_tokens(embedding, num_samples, generator, coupling.token_draw)

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


def _clean_chunks(
    model: DualheadModel, head: str, noise: Tensor, embedding: Tensor, shared: SharedDraws, num_steps: int
) -> tuple[Tensor, Tensor]:
    """Clean chunks (B, N, H * d) in a head's frame for its source noise, and which were held to its range (B, N)."""
    per_condition = noise.shape[1]
    source = noise.flatten(0, 1)
    if head in model.frames:
        source = model.frame(head).rotate(source)
    condition = torch.arange(len(noise), device=noise.device).repeat_interleave(per_condition)
    if shared.latent is not None:
        # Every chunk has a context of its own.
        context, index = model.context(embedding, latent=shared.latent).flatten(0, 1), None
    elif shared.token is not None:
        assert model.tokens is not None
        every = torch.arange(model.tokens.n_tokens, device=noise.device)
        context = model.context(embedding, token=every.expand(len(noise), -1)).flatten(0, 1)
        index = condition * len(every) + shared.token.flatten()
    else:
        context, index = model.context(embedding), condition
    clean = torch.empty_like(source)
    held = torch.empty(len(source), dtype=torch.bool, device=source.device)
    size = SAMPLING_ROWS if source.device.type == "cpu" else ACCELERATOR_SAMPLING_ROWS
    for rows, used, local in _pieces(index, len(source), len(context), size):
        clean[rows], held[rows] = _integrate(model, head, source[rows], context[used], local, num_steps)
    return clean.unflatten(0, noise.shape[:2]), held.unflatten(0, noise.shape[:2])


def _pieces(
    index: Tensor | None, n_rows: int, n_contexts: int, size: int
) -> Iterator[tuple[Tensor | slice, slice, Tensor | None]]:
    """Rows that are integrated together, the contexts that they use, and which of these each follows.

    Where a context has many rows they share its modulation; where it has few, rows of several contexts go together.
    """
    if index is None or n_contexts == 1:
        for start in range(0, n_rows, size):
            rows = slice(start, start + size)
            yield rows, rows if index is None else slice(None), None
        return
    order = index.argsort(stable=True)
    if size == SAMPLING_ROWS and n_rows >= ROWS_OF_ONE_CONTEXT * n_contexts:
        start = 0
        for context, count in enumerate(torch.bincount(index, minlength=n_contexts).tolist()):
            for piece in order[start : start + count].split(size):
                yield piece, slice(context, context + 1), None
            start += count
        return
    for piece in order.split(size):
        followed = index[piece]
        first, last = int(followed[0]), int(followed[-1])
        yield piece, slice(first, last + 1), None if first == last else followed - first


def _integrate(
    model: DualheadModel, head: str, source: Tensor, context: Tensor, index: Tensor | None, num_steps: int
) -> tuple[Tensor, Tensor]:
    """As :func:`integrate_within` does with the model's velocity; rows (R, H * d), contexts (C, E), index (R,)."""
    low, high = model.endpoint_range(head).bounds()
    x = source
    ends: list[Tensor] = []
    kept: list[Tensor] = []
    times = torch.arange(num_steps, dtype=source.dtype, device=source.device) / num_steps
    for block in times.split(max(1, FOLDED_CONTEXTS // len(context))):
        field = FoldedField(model, head, block, context)
        for step in range(len(block)):
            endpoint = field.endpoint(step, x, index)
            inside = endpoint.clamp(low, high)
            x = torch.lerp(x, inside, 1 / (num_steps - len(ends)))
            ends.append(endpoint)
            kept.append(inside)
    held = torch.stack(ends).ne(torch.stack(kept)).any(dim=0).any(dim=-1)
    return x, held


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

    Raises:
        ValueError: If the model has no such head, or needs a token or latent that is not given.
    """
    if head not in model.head_dims:
        raise ValueError(f"the policy has no head {head!r}: choose one of {list(model.head_dims)}")
    for name, part, given in (
        ("token", model.tokens, shared.token),
        ("latent", model.shared_latent, shared.latent),
    ):
        if (part is None) != (given is None):
            needs = f"needs a {name} for every row: pass {name}=..." if part is not None else f"has no {name}"
            raise ValueError(f"the policy {needs}")
    context = model.context(model.embed(observation), shared.token, shared.latent)
    frame = model.frame(head) if model.frames else None

    def velocity(x: Tensor, time: float) -> Tensor:
        y = x.flatten(1)
        y = y if frame is None else frame.rotate(y)
        moved = model.velocity(head, y, torch.full((len(y),), time, dtype=y.dtype, device=y.device), context)
        moved = moved if frame is None else moved @ frame.basis.T
        return moved.unflatten(1, x.shape[1:])

    return velocity
