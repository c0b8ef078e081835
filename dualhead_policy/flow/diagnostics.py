"""Diagnostics of a model in training: how far its heads lie apart, and how much they heed the latent."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dualhead_policy.flow.draws import draw_path_points, noisy_chunks
from dualhead_policy.flow.keyed_random import keyed_generator, step_key
from dualhead_policy.flow.loss import infer_latent
from dualhead_policy.kinematics.rotation6d import geodesic_angle, matrix_from_columns
from dualhead_policy.model.dualhead_model import DualheadModel


@torch.no_grad()
def teacher_forced_residuals(
    model: DualheadModel,
    observation: Tensor,
    action: Tensor,
    token: Tensor | None,
    *,
    seed: int,
    step: int,
    rank: int = 0,
) -> dict[str, float]:
    """How far the heads' clean endpoints lie apart on training samples, that is, given the data's own x_t.

    Unlike the residual of sampled chunks it holds no difference of modes, as x_t names the mode of its sample (all
    times weigh alike, the early ones too, where it hardly does). tab:pose gives its range for the third head.

    Args:
        model: The model.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D) in physical units.
        token: Tokens (B,), or None.
        seed, step, rank: Seed, training step and process of the run, of which the draws are a function.

    Returns:
        ``position_mm``, the mean distance between FK of the joint head's and the position head's endpoints; with a
        rotation head ``rotation_deg``, the mean angle between the joint head's and its own.
    """
    generator = keyed_generator(*step_key(seed, step, "residual", rank))
    chunks = noisy_chunks(model, observation, action, *draw_path_points(model, action, generator))
    embedding, latent = model.embed(observation), None
    if model.shared_latent is not None:
        latent = model.shared_latent.draw((len(action),), generator).to(action)
        if model.shared_latent.posterior is not None:
            # Teacher-forced in the latent too: the prior's draw would name another window than the data's.
            mean, deviation = infer_latent(model, action, embedding)
            latent = mean + deviation * latent
    context = model.context(embedding, token if model.tokens is not None else None, latent)
    endpoint = {}
    for head in model.head_slices:
        noisy = chunks.at_time(head)
        velocity = model.velocity(head, noisy, chunks.time, context)
        endpoint[head] = model.clean_endpoint(head, noisy, chunks.time, velocity, observation)
    apart = model.kinematics.position(endpoint["joint"]) - endpoint["position"]
    residuals = {"position_mm": 1000 * float(apart.norm(dim=-1).mean())}
    if "rotation" in endpoint:
        turned = matrix_from_columns(endpoint["rotation"])
        angle = geodesic_angle(model.kinematics.rotation(endpoint["joint"]), turned)
        residuals["rotation_deg"] = math.degrees(float(angle.mean()))
    return residuals


@torch.no_grad()
def latent_sensitivity(
    model: DualheadModel, observation: Tensor, action: Tensor, *, seed: int, step: int, rank: int = 0
) -> dict[str, float]:
    """How much each head's velocity depends on the latent (tab:sensitivity).

    The relative change |v(z') - v(z)| / |v(z)| over a batch when z is drawn anew, both from the standard normal; zero
    at the population optimum of a latent that is independent of the data (lem:zblind).

    Args:
        model: A model with a latent.
        observation: Preprocessed observations (B, C).
        action: Dual action windows (B, H, D) in physical units.
        seed, step, rank: Seed, training step and process of the run, of which the draws are a function.
    """
    assert model.shared_latent is not None
    generator = keyed_generator(*step_key(seed, step, "sensitivity", rank))
    chunks = noisy_chunks(model, observation, action, *draw_path_points(model, action, generator))
    embedding = model.embed(observation)
    contexts = []
    for _ in range(2):
        latent = model.shared_latent.draw((len(action),), generator).to(action)
        contexts.append(model.context(embedding, latent=latent))
    change = {}
    for head in model.head_slices:
        noisy = chunks.at_time(head)
        one, other = (model.velocity(head, noisy, chunks.time, context) for context in contexts)
        change[head] = float((other - one).norm() / one.norm())
    return change
