"""The losses and shared variables of every mechanism, one at a time, against analytic cases and independent oracles."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch.distributions import Normal, kl_divergence

from dualhead_policy.flow.consistency import position_consistency, rotation_consistency
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.kinematics.panda import panda_position, panda_rotation
from dualhead_policy.kinematics.rotation6d import columns_from_matrix, geodesic_angle, matrix_from_columns
from dualhead_policy.model.gripper import GripperOutput
from dualhead_policy.model.latent import SharedLatent, divergence_from_standard_normal, free_bits_penalty
from dualhead_policy.model.token_prior import TokenPrior

JOINTS = 0.3 * torch.randn(2, 3, 7, dtype=torch.float64, generator=keyed_generator(0)) + torch.tensor(
    [0, 0.2, 0, -2.5, 0, 2.7, -0.8], dtype=torch.float64
)


def test_heads_that_agree_have_no_consistency_loss():
    assert position_consistency(JOINTS, panda_position(JOINTS), panda_position, torch.ones(3)) == 0
    columns = columns_from_matrix(panda_rotation(JOINTS))
    assert rotation_consistency(JOINTS, columns, panda_rotation).item() < 1e-10


def test_a_distance_counts_in_the_given_units():
    offset = torch.tensor([0.01, 0.02, -0.03], dtype=torch.float64)
    away = panda_position(JOINTS) + offset
    meters = position_consistency(JOINTS, away, panda_position, torch.ones(3))
    assert meters.item() == pytest.approx((0.01**2 + 0.02**2 + 0.03**2) / 3)
    unit = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    assert position_consistency(JOINTS, away, panda_position, unit).item() == pytest.approx(0.1**2)


def test_on_a_linear_map_the_consistency_loss_is_a_quadratic_with_a_known_gradient():
    to_position = KinematicMap("ring/orthogonal").position
    joint = torch.randn(4, 5, 2, dtype=torch.float64, generator=keyed_generator(1)).requires_grad_()
    position = torch.randn(4, 5, 2, dtype=torch.float64, generator=keyed_generator(2)).requires_grad_()
    position_consistency(joint, position, to_position, torch.ones(2)).backward()
    difference = (to_position(joint) - position).detach()
    assert torch.allclose(position.grad, -2 * difference / difference.numel())
    # The map is orthogonal: its gradient has the same length.
    assert joint.grad.norm().item() == pytest.approx(position.grad.norm().item())


def test_consistency_gradients_through_the_arm_agree_with_finite_differences():
    joint = JOINTS.clone().requires_grad_()
    position = (panda_position(JOINTS) + 0.05).requires_grad_()
    columns = (columns_from_matrix(panda_rotation(JOINTS)) + 0.2).requires_grad_()
    spread = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda a, b: position_consistency(a, b, panda_position, spread), (joint, position))
    assert torch.autograd.gradcheck(lambda a, b: rotation_consistency(a, b, panda_rotation), (joint, columns))


@given(angle=st.floats(0, math.pi), axis=st.integers(0, 2))
def test_the_geodesic_angle_is_the_angle_of_the_turn_between(angle, axis):
    turn = torch.from_numpy(Rotation.from_euler("xyz"[axis], angle).as_matrix())
    start = torch.from_numpy(Rotation.from_euler("xyz", [0.3, -1, 2]).as_matrix())
    assert geodesic_angle(start, start @ turn).item() == pytest.approx(angle, abs=2e-6)


def test_the_squared_angle_can_be_differentiated_where_rotations_coincide():
    columns = columns_from_matrix(panda_rotation(JOINTS)).requires_grad_()
    rotation_consistency(JOINTS, columns, panda_rotation).backward()
    assert torch.isfinite(columns.grad).all()
    assert columns.grad.abs().max() < 1e-4


@given(seed=st.integers(0, 1000))
def test_six_numbers_become_the_rotation_whose_columns_they_span(seed):
    rotation = torch.from_numpy(Rotation.random(rng=np.random.default_rng(seed)).as_matrix())
    columns = columns_from_matrix(rotation)
    assert torch.allclose(matrix_from_columns(columns), rotation)
    first, second = columns[:3], columns[3:]
    sheared = torch.cat([3 * first, 2 * second - 0.7 * first])
    assert torch.allclose(matrix_from_columns(sheared), rotation)


@given(mean=st.floats(-3, 3), deviation=st.floats(0.01, 3))
def test_the_divergence_is_that_of_torch_distributions(mean, deviation):
    mean, deviation = torch.tensor(mean, dtype=torch.float64), torch.tensor(deviation, dtype=torch.float64)
    expected = kl_divergence(Normal(mean, deviation), Normal(torch.zeros_like(mean), torch.ones_like(mean)))
    assert divergence_from_standard_normal(mean, deviation).item() == pytest.approx(
        expected.item(), rel=1e-9, abs=1e-12
    )


def test_free_bits_are_not_penalised_and_have_no_gradient():
    divergence = torch.tensor([[0.2, 1.0], [0.0, 3.0]], requires_grad=True)
    penalty = free_bits_penalty(divergence, 0.5)
    assert penalty.item() == pytest.approx(0.5 + 2.0)
    penalty.backward()
    assert divergence.grad.tolist() == [[0, 0.5], [0, 0.5]]


def test_the_anchor_of_dimension_zero_says_nothing():
    anchor = SharedLatent(0, 0)
    assert not list(anchor.parameters())
    assert torch.equal(anchor.encode(anchor.draw((3, 2), None)), torch.zeros(3, 2, 32))
    assert SharedLatent(16, 0).encode(torch.randn(3, 16)).shape == (3, 32)


def test_a_posterior_has_a_positive_deviation_and_the_gradient_of_its_sample():
    latent = SharedLatent(2, 7).double()
    chunk, embedding = torch.randn(3, 4, dtype=torch.float64), torch.randn(3, 3, dtype=torch.float64)
    mean, deviation = latent.infer(chunk, embedding)
    assert mean.shape == deviation.shape == (3, 2)
    assert (deviation > 0).all()
    noise = latent.draw((3,), keyed_generator(5)).double()
    assert torch.autograd.gradcheck(
        lambda c: sum(latent.infer(c, embedding)[i] * (1, noise)[i] for i in (0, 1)), chunk.requires_grad_()
    )


def test_the_token_prior_learns_the_frequencies_and_leaves_the_embedding_alone():
    torch.manual_seed(0)
    prior = TokenPrior(2, 3)
    embedding = torch.tensor([[1.0, 0.0], [0.0, 1.0]]).repeat(60, 1).requires_grad_()
    token = torch.tensor([0, 2] * 40 + [1, 2] * 20)
    optimizer = torch.optim.Adam(prior.parameters(), lr=0.02)
    for _ in range(300):
        optimizer.zero_grad()
        prior.loss(embedding, token).backward()
        optimizer.step()
    assert embedding.grad is None
    drawn = prior.draw(embedding[:2].detach(), 20_000, keyed_generator(0))
    share = torch.stack([torch.bincount(row, minlength=3) / 20_000 for row in drawn])
    assert share[0].numpy() == pytest.approx([2 / 3, 1 / 3, 0], abs=0.03)
    assert share[1].numpy() == pytest.approx([0, 0, 1], abs=0.03)


def test_the_gripper_learns_when_to_close():
    torch.manual_seed(0)
    gripper = GripperOutput(1, 4)
    observation = torch.linspace(-1, 1, 64)[:, None]
    command = torch.where(observation + torch.arange(4) * 0.25 > 0, 1.0, -1.0)
    optimizer = torch.optim.Adam(gripper.parameters(), lr=0.01)
    for _ in range(300):
        optimizer.zero_grad()
        gripper.loss(observation, command).backward()
        optimizer.step()
    assert set(gripper.commands(observation).unique().tolist()) == {-1.0, 1.0}
    assert (gripper.commands(observation) == command).float().mean() > 0.97
