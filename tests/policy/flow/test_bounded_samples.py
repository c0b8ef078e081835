"""Samples stay near the training chunks whatever is observed, and whatever the network makes of it."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from dualhead_envs.dataset_frames import read_split
from dualhead_policy import DualheadConfig, SamplingCoupling
from dualhead_policy.flow.flow_matching import integrate_euler, integrate_within
from dualhead_policy.flow.keyed_random import keyed_generator

NETWORKS = {
    "default": {},
    "paper": {"preconditioning": "none", "conditioning": "concat"},
    "latent": {"latent": "prior"},
}


@pytest.fixture(scope="module", params=NETWORKS)
def wild_policy(panda_data, request):
    """A policy whose fields amplify whatever they are given: fitted scales, weights far too large."""
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    config = DualheadConfig(velocity_width=16, encoder_dim=8, seed=0, device="cpu", **NETWORKS[request.param])
    policy = make_policy(config, ds_meta=meta).eval()
    generator = keyed_generator(0)
    for parameter in policy.model.network.parameters():
        torch.nn.init.normal_(parameter, std=3.0, generator=generator)
    return policy


def batch_of(policy, direction, size):
    dims = {key: policy.config.input_features[key].shape[0] for key in policy.observation_keys}
    generator = keyed_generator(direction)
    return {key: size * torch.randn(3, dim, generator=generator) for key, dim in dims.items()}


@given(direction=st.integers(0, 10**6), exponent=st.floats(-2, 37))
@settings(max_examples=25, deadline=None)
def test_samples_stay_bounded_for_any_finite_observation(wild_policy, panda_data, direction, exponent):
    batch = batch_of(wild_policy, direction, 10.0**exponent)
    samples = wild_policy.sample(batch, 4, generator=keyed_generator(1))
    actions = torch.from_numpy(read_split(panda_data / "train").action)
    for head, part in wild_policy.model.head_slices.items():
        chunk, seen = getattr(samples, head), actions[:, part]
        assert torch.isfinite(chunk).all()
        # Ten ranges of the training data: the frame's axes turn its box, so that corners reach further than a side.
        width = (seen.amax(dim=0) - seen.amin(dim=0)).amax().clamp(min=0.1)
        assert ((chunk - seen.mean(dim=0)).abs() < 10 * width).all()


def test_what_was_held_is_said(wild_policy):
    samples = wild_policy.sample(batch_of(wild_policy, 0, 1.0), 8, generator=keyed_generator(1))
    assert samples.diverged.shape == (3, 8)
    assert samples.diverged.any()


def test_an_observation_that_is_not_finite_is_refused(wild_policy):
    batch = batch_of(wild_policy, 0, 1.0)
    next(iter(batch.values()))[0, 0] = torch.nan
    with pytest.raises(ValueError, match="non-finite value, expected finite ones"):
        wild_policy.sample(batch, 1, coupling=SamplingCoupling())


def test_a_flow_that_stays_inside_is_integrated_as_without_a_range():
    source = torch.randn(50, 4, generator=keyed_generator(0), dtype=torch.float64)
    bounds = torch.full((4,), -9.0, dtype=torch.float64), torch.full((4,), 9.0, dtype=torch.float64)

    def velocity(x, t):
        return torch.sin(x) - t * x

    ours, held = integrate_within(velocity, source, 20, *bounds)
    assert not held.any()
    assert torch.allclose(ours, integrate_euler(velocity, source, 20))
