"""The coupling of sampled heads, resolved: which source noise, token and latent each head's samples follow."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dualhead_policy.flow.flow_matching import coupled_source_noise
from dualhead_policy.sampling import NOISE_ALIGNMENTS, SamplingCoupling


@dataclass(frozen=True)
class SharedDraws:
    """What a head's samples follow: tokens (B, N), or latents (B, N, dim), or neither."""

    token: Tensor | None = None
    latent: Tensor | None = None


def resolve_source_noise(
    coupling: SamplingCoupling,
    shape: tuple[int, ...],
    head_dims: Mapping[str, int],
    beta: float,
    generator: torch.Generator | None,
    private: Collection[str] = (),
    alignment: Callable[[], Mapping[str, Tensor]] | None = None,
    own_alignment: str | None = None,
) -> Mapping[str, Tensor]:
    """Source noise by head, each (*shape, d): the caller's, or drawn with the caller's beta or else ``beta``.

    The noise of ``private`` heads is their own whatever beta. ``alignment`` gives what carries the shared noise to the
    heads where the caller or the sampler itself (``own_alignment``) asks for it, or is None for a sampler without a
    kinematic map to align by.

    Raises:
        ValueError: If the caller's noise lacks a head, or an alignment is asked for that is unknown, not there, or of
            private noise.
    """
    if coupling.source_noise:
        missing = sorted(set(head_dims) - set(coupling.source_noise))
        if missing:
            raise ValueError(f"coupling.source_noise lacks {missing}: give the noise of every head")
        return coupling.source_noise
    beta = _asked_beta(coupling, beta)
    aligned, asked = None, coupling.source_noise_alignment or own_alignment
    if asked is not None:
        if asked not in NOISE_ALIGNMENTS:
            raise ValueError(
                f"source_noise_alignment={asked!r} is none of {', '.join(NOISE_ALIGNMENTS)}: give one of them, or "
                "leave it out"
            )
        if alignment is None:
            raise ValueError(
                "the sampler has no kinematic map to align its source noise by: leave source_noise_alignment out"
            )
        require_shared_noise(coupling, beta)
        aligned = alignment()
    return coupled_source_noise(shape, head_dims, beta, generator, private, aligned)


def require_shared_noise(coupling: SamplingCoupling, beta: float) -> None:
    """Refuse an alignment of noise that the heads do not share; ``beta`` is the sampler's own.

    Raises:
        ValueError: If the caller asks for an alignment and the noise is private.
    """
    if coupling.source_noise_alignment is not None and _asked_beta(coupling, beta) == 1:
        raise ValueError(
            f"source_noise_alignment={coupling.source_noise_alignment!r} is about noise that the heads share, and "
            "source_noise_beta=1 shares none: give source_noise_beta=0 too, or leave the alignment out"
        )


def _asked_beta(coupling: SamplingCoupling, beta: float) -> float:
    return beta if coupling.source_noise_beta is None else coupling.source_noise_beta


def resolve_shared_draws(
    coupling: SamplingCoupling,
    heads: Sequence[str],
    draw_token: Callable[[], Tensor] | None,
    draw_latent: Callable[[], Tensor] | None,
) -> dict[str, SharedDraws]:
    """What each head's samples follow: the caller's token or latent, or one drawn, and others where heads do not share.

    Args:
        coupling: The caller's choices.
        heads: Names of the heads; those after the first draw anew where they do not share.
        draw_token: Draws tokens (B, N), or None for a sampler without tokens.
        draw_latent: Draws latents (B, N, dim), or None for a sampler without a latent.

    Raises:
        ValueError: If the caller gives a token or latent that the sampler does not have.
    """
    for name, draw, given in (("token", draw_token, coupling.token), ("latent", draw_latent, coupling.latent)):
        if given is not None and draw is None:
            raise ValueError(f"the policy has no {name} to follow: sample it without coupling.{name}")
    if coupling.token_draw is not None and draw_token is None:
        raise ValueError("the policy has no token to draw: leave --token-draw or coupling.token_draw out")

    def drawn(token: Tensor | None = None, latent: Tensor | None = None) -> SharedDraws:
        if token is None and draw_token is not None:
            token = draw_token()
        if latent is None and draw_latent is not None:
            latent = draw_latent()
        return SharedDraws(token, latent)

    first = drawn(coupling.token, coupling.latent)
    apart = (draw_token is not None and not coupling.share_token) or (
        draw_latent is not None and not coupling.share_latent
    )
    return {head: first if head == heads[0] or not apart else drawn() for head in heads}
