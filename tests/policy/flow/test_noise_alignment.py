"""Noise that goes through the kinematic map: an isometry, standard normal for every head, and what the two share."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies.factory import make_policy
from scipy.linalg import orthogonal_procrustes

from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.geometry import HORIZON
from dualhead_envs.ring.maps import REPRESENTATION_MAPS
from dualhead_eval.exact_reference import ExactReference
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.flow.coupling import resolve_source_noise
from dualhead_policy.flow.flow_matching import coupled_source_noise
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.flow.noise_alignment import kinematic_alignment, polar_factor
from dualhead_policy.kinematics.panda import panda_position
from dualhead_policy.pretrained import load_policy, policy_folder
from dualhead_policy.sampling import SamplingCoupling

SAMPLES = 40_000
ALIGNED = SamplingCoupling(source_noise_beta=0.0, source_noise_alignment="kinematic")


def matrix(rows, columns, seed):
    return torch.randn(rows, columns, generator=keyed_generator(seed), dtype=torch.float64)


@given(width=st.integers(2, 7), seed=st.integers(0, 2**31))
def test_the_polar_factor_is_scipys_orthogonal_procrustes(width, seed):
    cross = matrix(width, width, seed)
    nearest, _ = orthogonal_procrustes(np.eye(width), cross.numpy())
    np.testing.assert_allclose(polar_factor(cross).numpy(), nearest, atol=1e-6)


@given(wide=st.integers(3, 7), narrow=st.integers(1, 3), rank=st.integers(1, 3), seed=st.integers(0, 2**31))
def test_a_direction_that_the_map_does_not_move_is_left_out(wide, narrow, rank, seed):
    rank = min(rank, narrow)
    factor = polar_factor(matrix(wide, rank, seed) @ matrix(rank, narrow, seed + 1))
    kept = torch.linalg.eigvalsh(factor.T @ factor)
    np.testing.assert_allclose(kept[narrow - rank :], 1, atol=1e-6)
    np.testing.assert_allclose(kept[: narrow - rank], 0, atol=1e-6)


@pytest.mark.parametrize("broken", [torch.zeros(7, 3), torch.full((7, 3), torch.nan), torch.full((2, 2), torch.inf)])
def test_a_map_that_cannot_be_linearised_is_refused(broken):
    with pytest.raises(ValueError, match="derivative at the mean action is zero or not finite"):
        polar_factor(broken)


@pytest.mark.parametrize("beta", [0.0, 0.3])
@pytest.mark.parametrize("rank", [2, 3])
def test_aligned_noise_is_standard_normal_and_correlated_by_the_alignment(beta, rank):
    carry = polar_factor(matrix(7, rank, 1) @ matrix(rank, 3, 2)).float()
    noise = coupled_source_noise((SAMPLES,), {"joint": 7, "position": 3}, beta, keyed_generator(3), (),
                                 {"position": carry})  # fmt: skip
    joined = np.concatenate([noise["joint"].numpy(), noise["position"].numpy()], axis=1)
    expected = np.eye(10)
    expected[:7, 7:], expected[7:, :7] = (1 - beta) * carry.numpy(), (1 - beta) * carry.numpy().T
    assert np.abs(joined.mean(axis=0)).max() < 5 / SAMPLES**0.5
    assert np.abs(np.cov(joined, rowvar=False) - expected).max() < 5 * (2 / SAMPLES) ** 0.5


@pytest.mark.parametrize("name", ["orthogonal", "nullspace", "overlap-90", "rotation+135"])
def test_through_a_linear_map_both_heads_take_the_same_path(name):
    """Whatever sign the map gives noise that is shared coordinate by coordinate (here from -71 to +50 %)."""
    conditions = RingGenerator(2).draw_conditions(np.random.default_rng(0), 6)
    batch = {"observation.environment_state": torch.from_numpy(conditions).float()}
    samples = ExactReference(2, name).sample(batch, 40, coupling=ALIGNED, generator=keyed_generator(0))
    reached = REPRESENTATION_MAPS[name].to_position(samples.joint.double().numpy())
    np.testing.assert_allclose(reached, samples.position.numpy(), atol=1e-4)


def test_a_trained_rings_alignment_is_its_map(trained):
    policy, _ = load_policy(policy_folder(trained))
    (carry,) = kinematic_alignment(policy.model).values()
    ring_map = REPRESENTATION_MAPS[policy.config.representation.ring_map]
    np.testing.assert_allclose(carry.numpy(), ring_map.matrix, atol=1e-5)


def test_on_the_arm_joints_that_turn_about_the_vertical_carry_the_lateral_noise(panda_data):
    """Joints 1, 3, 5, 7 move the hand sideways, 2, 4, 6 within the arm's plane: the Jacobian at the mean says so."""
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    policy = make_policy(DualheadConfig(device="cpu", velocity_width=32), ds_meta=meta)
    model = policy.model
    carry = kinematic_alignment(model)["position"]
    torch.testing.assert_close(carry.T @ carry, torch.eye(3), atol=1e-5, rtol=0)
    middle = model.action_scale.shift[model.head_slices["joint"]].double()
    moved = torch.autograd.functional.jacobian(panda_position, middle)
    sideways = moved[1].abs() > moved[[0, 2]].abs().amax(dim=0)
    carried = carry[:, 1].abs() > carry[:, [0, 2]].abs().amax(dim=1)
    assert carried[:6].tolist() == sideways[:6].tolist() == [True, False] * 3
    assert carried[6]  # it moves nothing, the hand turns about its axis; but it turns with the others


def test_a_policy_that_asks_for_it_samples_so_by_itself(panda_data):
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    small = {"device": "cpu", "velocity_width": 32, "seed": 0}
    own = make_policy(
        DualheadConfig(source_noise_beta=0.0, source_noise_alignment="kinematic", **small), ds_meta=meta
    ).eval()
    asked = make_policy(DualheadConfig(**small), ds_meta=meta).eval()
    asked.load_state_dict(own.state_dict())
    batch = {key: torch.zeros(1, *feature.shape) for key, feature in own.config.input_features.items()}
    with torch.inference_mode():  # as LeRobot does
        first = own.sample(batch, 8, generator=keyed_generator(0))
    second = asked.sample(batch, 8, coupling=ALIGNED, generator=keyed_generator(0))
    assert torch.equal(first.joint, second.joint)
    assert torch.equal(first.position, second.position)
    apart = asked.sample(batch, 8, coupling=SamplingCoupling(source_noise_beta=0.0), generator=keyed_generator(0))
    assert torch.equal(first.joint, apart.joint)
    assert not torch.allclose(first.position, apart.position)


def test_what_has_no_map_or_no_such_alignment_is_refused():
    generator, dims = keyed_generator(0), {"joint": 2, "position": 2}
    with pytest.raises(ValueError, match="no kinematic map to align"):
        resolve_source_noise(ALIGNED, (1, 1, HORIZON), dims, 0.0, generator)
    with pytest.raises(ValueError, match="'mirror' is none of kinematic"):
        resolve_source_noise(SamplingCoupling(source_noise_alignment="mirror"), (1, 1, HORIZON), dims, 0.0, generator)
    private = SamplingCoupling(source_noise_beta=1.0, source_noise_alignment="kinematic")
    with pytest.raises(ValueError, match="source_noise_beta=1 shares none: give source_noise_beta=0 too"):
        resolve_source_noise(private, (1, 1, HORIZON), dims, 0.0, generator, alignment=dict)
    batch = {"observation.environment_state": torch.tensor([[1.0, 0.0, 1.0]])}
    with pytest.raises(ValueError, match="no kinematic map to align"):
        ExactReference(2, "polar").sample(batch, 1, coupling=ALIGNED, generator=generator)
