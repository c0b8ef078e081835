"""The training loss: flow matching of every head, and what the configured mechanisms add to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from dualhead_policy.flow.consistency import consistency_deviation, position_consistency, rotation_consistency
from dualhead_policy.flow.flow_matching import coupled_source_noise, interpolate
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.kinematics.kinematic_map import position_map, rotation_map
from dualhead_policy.kinematics.rotation6d import geodesic_angle, matrix_from_columns
from dualhead_policy.model.latent import divergence_from_standard_normal, free_bits_penalty

if TYPE_CHECKING:
    from dualhead_policy.modeling_dualhead import DualheadPolicy


@dataclass(frozen=True)
class NoisyChunks:
    """One point of every head's interpolation path, in the heads' frames, flattened.

    Attributes:
        time: t (B,), the same for all heads.
        source, target: y_0 and y_1 by head, each (B, H * d).
    """

    time: Tensor
    source: dict[str, Tensor]
    target: dict[str, Tensor]

    def at_time(self, head: str) -> Tensor:
        """y_t (B, H * d)."""
        return interpolate(self.source[head], self.target[head], self.time)


def draw_noisy_chunks(
    policy: DualheadPolicy, observation: Tensor, action: Tensor, generator: torch.Generator
) -> NoisyChunks:
    """Draw time and source noise for a batch of windows (B, H, D) in physical units."""
    config = policy.config
    n = len(action)
    time = torch.rand(n, generator=generator, device=action.device).to(action.dtype)
    noise = coupled_source_noise((n, config.chunk_size), policy.head_dims, config.source_noise_beta, generator)
    normalized = policy.action_scale.normalize(action)
    source, target = {}, {}
    for head, part in policy.head_slices.items():
        source[head] = noise[head].to(action.dtype).flatten(1)
        target[head] = normalized[..., part].flatten(1)
        if head in policy.frames:
            source[head] = policy.frame(head).rotate(source[head])
            target[head] = policy.frame(head).enter(target[head], observation)
    return NoisyChunks(time, source, target)


def training_loss(
    policy: DualheadPolicy, observation: Tensor, action: Tensor, token: Tensor | None
) -> tuple[Tensor, dict[str, Tensor]]:
    """The training loss and its parts, already weighted.

    Every head contributes its flow-matching loss (eq:cfm), the mean squared error per coordinate, and the mechanisms
    theirs. All draws are functions of (seed, training step): time, source noise and token corruption come from one
    keyed generator, latents and observation noise from their own, so that a mechanism leaves the draws of the others
    as they are.

    Args:
        policy: The policy.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D) in physical units.
        token: Clean tokens (B,), or None.
    """
    config = policy.config
    purpose = "train" if policy.training else "validate"
    key = (config.seed or 0, int(policy.training_step), purpose)
    generator = keyed_generator(*key, device=action.device)
    if config.observation_noise and policy.training:
        noise = torch.randn(
            observation.shape,
            generator=keyed_generator(*key, "observation", device=action.device),
            device=action.device,
        )
        observation = observation + config.observation_noise * noise.to(observation.dtype)
    chunks = draw_noisy_chunks(policy, observation, action, generator)
    context = embedding = policy.network.encoder(observation)
    shared: dict[str, Tensor] = {}
    if policy.tokens is not None and token is not None:
        if policy.token_prior is not None:
            shared["token_prior"] = policy.token_prior.loss(embedding, token)
        token = policy.tokens.corrupt(
            token,
            replacement_prob=config.token_replacement_prob,
            null_prob=config.token_null_prob,
            generator=generator,
        )
        context = torch.cat([embedding, policy.tokens.one_hot(token)], dim=-1)
    if policy.shared_latent is not None:
        latent = policy.shared_latent.draw((len(action),), keyed_generator(*key, "latent", device=action.device))
        latent = latent.to(action.dtype)
        if policy.shared_latent.posterior is not None:
            normalized = policy.action_scale.normalize(action)
            seen = [normalized[..., part].flatten(1) for part in policy.head_slices.values()]
            mean, deviation = policy.shared_latent.infer(torch.cat(seen, dim=-1), embedding)
            latent = mean + deviation * latent
            divergence = divergence_from_standard_normal(mean, deviation)
            shared["kl"] = config.kl_weight * free_bits_penalty(divergence, config.free_bits)
        context = torch.cat([embedding, policy.shared_latent.encode(latent)], dim=-1)
    parts, endpoint = {}, {}
    for head in policy.head_slices:
        y = chunks.at_time(head)
        velocity = policy.head_velocity(head, y, chunks.time, context)
        parts[head] = (velocity - (chunks.target[head] - chunks.source[head])).square().mean()
        if config.consistency_weight > 0 or config.rotation_consistency_weight > 0:
            clean = y + (1 - chunks.time[:, None]) * velocity
            endpoint[head] = policy.physical_chunk(head, clean, observation)
    parts |= shared | _consistency(policy, endpoint)
    if policy.gripper is not None:
        command = action[..., policy.representation.slices["gripper"]].squeeze(-1)
        parts["gripper"] = policy.gripper.loss(observation, command)
    return sum(parts.values(), torch.zeros((), device=action.device)), parts


def _consistency(policy: DualheadPolicy, endpoint: dict[str, Tensor]) -> dict[str, Tensor]:
    config, parts = policy.config, {}
    kinematics = policy.representation.kinematic_map
    if config.consistency_weight > 0:
        scale, part = policy.action_scale, policy.head_slices["position"]
        deviation = consistency_deviation(config.consistency_norm, (scale.spread * scale.scale)[part])
        parts["consistency"] = config.consistency_weight * position_consistency(
            endpoint["joint"], endpoint["position"], position_map(kinematics), deviation
        )
    if config.rotation_consistency_weight > 0:
        parts["rotation_consistency"] = config.rotation_consistency_weight * rotation_consistency(
            endpoint["joint"], endpoint["rotation"], rotation_map(kinematics)
        )
    return parts


@torch.no_grad()
def teacher_forced_residuals(
    policy: DualheadPolicy, observation: Tensor, action: Tensor, token: Tensor | None
) -> dict[str, float]:
    """How far the heads' clean endpoints lie apart on training samples, that is, given the data's own x_t.

    Unlike the residual of sampled chunks it holds no difference of modes, as x_t names the mode of its sample (all
    times weigh alike, the early ones too, where it hardly does). tab:pose gives its range for the third head.

    Args:
        policy: The policy.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D) in physical units.
        token: Tokens (B,), or None.

    Returns:
        ``position_mm``, the mean distance between FK of the joint head's and the position head's endpoints; with a
        rotation head ``rotation_deg``, the mean angle between the joint head's and its own.
    """
    key = (policy.config.seed or 0, int(policy.training_step), "residual")
    generator = keyed_generator(*key, device=action.device)
    chunks = draw_noisy_chunks(policy, observation, action, generator)
    context = policy.network.encoder(observation)
    if policy.tokens is not None and token is not None:
        context = torch.cat([context, policy.tokens.one_hot(token)], dim=-1)
    if policy.shared_latent is not None:
        latent = policy.shared_latent.draw((len(action),), generator).to(action.dtype)
        context = torch.cat([context, policy.shared_latent.encode(latent)], dim=-1)
    endpoint = {}
    for head in policy.head_slices:
        y = chunks.at_time(head)
        clean = y + (1 - chunks.time[:, None]) * policy.head_velocity(head, y, chunks.time, context)
        endpoint[head] = policy.physical_chunk(head, clean, observation)
    kinematics = policy.representation.kinematic_map
    apart = position_map(kinematics)(endpoint["joint"]) - endpoint["position"]
    residuals = {"position_mm": 1000 * float(apart.norm(dim=-1).mean())}
    if "rotation" in endpoint:
        turned = matrix_from_columns(endpoint["rotation"])
        angle = geodesic_angle(rotation_map(kinematics)(endpoint["joint"]), turned)
        residuals["rotation_deg"] = math.degrees(float(angle.mean()))
    return residuals


@torch.no_grad()
def latent_sensitivity(policy: DualheadPolicy, observation: Tensor, action: Tensor) -> dict[str, float]:
    """How much each head's velocity depends on the latent (tab:sensitivity).

    The relative change |v(z') - v(z)| / |v(z)| over a batch when z is drawn anew, both from the standard normal; zero
    at the population optimum of a latent that is independent of the data (lem:zblind).

    Args:
        policy: A policy with a latent.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D) in physical units.
    """
    assert policy.shared_latent is not None
    key = (policy.config.seed or 0, int(policy.training_step), "sensitivity")
    generator = keyed_generator(*key, device=action.device)
    chunks = draw_noisy_chunks(policy, observation, action, generator)
    embedding = policy.network.encoder(observation)
    contexts = []
    for _ in range(2):
        latent = policy.shared_latent.draw((len(action),), generator).to(action.dtype)
        contexts.append(torch.cat([embedding, policy.shared_latent.encode(latent)], dim=-1))
    change = {}
    for head in policy.head_slices:
        one, other = (policy.head_velocity(head, chunks.at_time(head), chunks.time, c) for c in contexts)
        change[head] = float((other - one).norm() / one.norm())
    return change
