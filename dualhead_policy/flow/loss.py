"""The training loss: flow matching of every head, and what the configured mechanisms add to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.flow.consistency import position_consistency, rotation_consistency
from dualhead_policy.flow.draw_rule import StepDraws
from dualhead_policy.flow.draws import noisy_chunks
from dualhead_policy.model.dualhead_model import HEADS, DualheadModel
from dualhead_policy.model.latent import divergence_from_standard_normal, free_bits_penalty


@dataclass(frozen=True)
class LossWeights:
    """The numbers of a configuration that enter the loss; tensors where runs that train as one differ in them."""

    observation_noise: float | Tensor
    token_replacement_prob: float | Tensor
    token_null_prob: float | Tensor
    kl_weight: float | Tensor
    free_bits: float | Tensor
    consistency_weight: float | Tensor
    rotation_consistency_weight: float | Tensor

    @classmethod
    def of(cls, config: DualheadConfig) -> LossWeights:
        """Those of a configuration, with no field left open."""
        return cls(**{name: getattr(config, name) or 0.0 for name in cls.__dataclass_fields__})


def training_loss(
    model: DualheadModel,
    observation: Tensor,
    action: Tensor,
    token: Tensor | None,
    draws: StepDraws,
    weights: LossWeights | None = None,
) -> tuple[Tensor, dict[str, Tensor]]:
    """The training loss and its parts, already weighted; a deterministic function of its arguments.

    Every head contributes its flow-matching loss (eq:cfm), the mean squared error per coordinate, and the mechanisms
    theirs.

    Args:
        model: The model.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D) in physical units.
        token: Clean tokens (B,), or None.
        draws: Everything random.
        weights: Numbers in place of those of the model's configuration, which still says what there is.
    """
    config = model.config
    weights = weights or LossWeights.of(config)
    if draws.observation_noise is not None:
        observation = observation + weights.observation_noise * draws.observation_noise
    chunks = noisy_chunks(model, observation, action, draws.time, draws.source)
    embedding = model.embed(observation)
    shared: dict[str, Tensor] = {}
    latent = None
    if token is not None and model.tokens is not None:
        if model.token_prior is not None:
            shared["token_prior"] = model.token_prior.loss(embedding, token)
        if draws.corruption is not None:
            token = model.tokens.corrupt(
                token,
                draws.corruption,
                replacement_prob=weights.token_replacement_prob,
                null_prob=weights.token_null_prob,
            )
    if draws.latent is not None and model.shared_latent is not None:
        latent = draws.latent
        if model.shared_latent.posterior is not None:
            mean, deviation = infer_latent(model, action, embedding)
            latent = mean + deviation * latent
            divergence = divergence_from_standard_normal(mean, deviation)
            shared["kl"] = weights.kl_weight * free_bits_penalty(divergence, weights.free_bits)
    context = model.context(embedding, token if model.tokens is not None else None, latent)
    parts, endpoint = {}, {}
    for head in model.head_slices:
        noisy = chunks.at_time(head)
        velocity = model.velocity(head, noisy, chunks.time, context)
        parts[head] = (velocity - (chunks.target[head] - chunks.source[head])).square().mean()
        if config.consistency_weight > 0 or config.rotation_consistency_weight > 0:
            endpoint[head] = model.clean_endpoint(head, noisy, chunks.time, velocity, observation)
    parts |= shared | _consistency(model, endpoint, weights)
    if model.gripper is not None:
        command = action[..., model.layout.slices["gripper"]].squeeze(-1)
        parts["gripper"] = model.gripper.loss(observation, command)
    return sum(parts.values(), torch.zeros((), device=action.device)), parts


def flow_loss(parts: Mapping[str, Tensor]) -> Tensor:
    """The heads' flow-matching losses alone, summed: what settles when a velocity field has been learnt."""
    first, *others = (parts[head] for head in HEADS if head in parts)
    return sum(others, first)


def infer_latent(model: DualheadModel, action: Tensor, embedding: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (B, dim) of the posterior q(z | x_1, c), which sees the clean chunks of all heads."""
    assert model.shared_latent is not None
    normalized = model.action_scale.normalize(action)
    seen = [normalized[..., part].flatten(1) for part in model.head_slices.values()]
    return model.shared_latent.infer(torch.cat(seen, dim=-1), embedding)


def _consistency(model: DualheadModel, endpoint: dict[str, Tensor], weights: LossWeights) -> dict[str, Tensor]:
    config, parts = model.config, {}
    if config.consistency_weight > 0:
        scale = model.action_scale.scale[model.head_slices["position"]]
        deviation = scale if config.consistency_norm == "normalized" else torch.ones_like(scale)
        parts["consistency"] = weights.consistency_weight * position_consistency(
            endpoint["joint"], endpoint["position"], model.kinematics.position, deviation
        )
    if config.rotation_consistency_weight > 0:
        parts["rotation_consistency"] = weights.rotation_consistency_weight * rotation_consistency(
            endpoint["joint"], endpoint["rotation"], model.kinematics.rotation
        )
    return parts
