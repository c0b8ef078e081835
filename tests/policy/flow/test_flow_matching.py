"""Flow matching: coupled noise has the stated covariance, and the integrator integrates."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dualhead_policy.flow.flow_matching import coupled_source_noise, integrate_euler, interpolate
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.model.network import gaussian_preconditioning

SAMPLES = 40_000


@pytest.mark.parametrize("beta", [0.0, 0.1, 0.5, 1.0])
def test_coupled_noise_is_standard_normal_per_head_and_correlated_by_one_minus_beta(beta):
    noise = coupled_source_noise((SAMPLES,), {"joint": 6, "position": 2}, beta, keyed_generator(0))
    joined = np.concatenate([noise["joint"].numpy(), noise["position"].numpy()], axis=1)
    expected = np.eye(8)
    expected[[0, 1], [6, 7]] = expected[[6, 7], [0, 1]] = 1 - beta
    assert np.abs(joined.mean(axis=0)).max() < 5 / SAMPLES**0.5
    assert np.abs(np.cov(joined, rowvar=False) - expected).max() < 5 * (2 / SAMPLES) ** 0.5


def test_the_narrower_head_takes_the_first_coordinates_of_the_shared_noise():
    noise = coupled_source_noise((3, 16), {"joint": 7, "position": 3, "rotation": 6}, 0.0, keyed_generator(1))
    assert torch.equal(noise["joint"][..., :3], noise["position"])
    assert torch.equal(noise["joint"][..., :6], noise["rotation"])


@pytest.mark.parametrize("beta", [0.0, 0.5, 1.0])
def test_a_private_heads_noise_is_independent_and_leaves_the_others_as_they_were(beta):
    dims = {"joint": 7, "position": 3, "rotation": 6}
    noise = coupled_source_noise((SAMPLES,), dims, beta, keyed_generator(1), private=("rotation",))
    for head in ("joint", "position"):
        correlation = np.corrcoef(noise["rotation"][:, 0], noise[head][:, 0])[0, 1]
        assert abs(correlation) < 5 / SAMPLES**0.5
    assert noise["rotation"].std() == pytest.approx(1, abs=0.02)
    coupled = coupled_source_noise((SAMPLES,), {"joint": 7, "position": 3}, beta, keyed_generator(1))
    torch.testing.assert_close(noise["joint"], coupled["joint"], rtol=0, atol=0)
    torch.testing.assert_close(noise["position"], coupled["position"], rtol=0, atol=0)


@given(seed=st.integers(0, 2**31), step=st.integers(0, 10**9))
def test_draws_depend_on_seed_and_step_alone(seed, step):
    first = torch.randn(4, generator=keyed_generator(seed, step, "train"))
    torch.randn(1000)
    assert torch.equal(first, torch.randn(4, generator=keyed_generator(seed, step, "train")))
    assert not torch.equal(first, torch.randn(4, generator=keyed_generator(seed, step + 1, "train")))


def test_interpolation_runs_from_source_to_target():
    source, target = torch.randn(3, 16, 2), torch.randn(3, 16, 2)
    assert torch.equal(interpolate(source, target, torch.zeros(3)), source)
    assert torch.allclose(interpolate(source, target, torch.ones(3)), target)


def test_euler_follows_a_constant_velocity_exactly_and_converges_at_first_order():
    start = torch.zeros(5, dtype=torch.float64)
    assert torch.allclose(integrate_euler(lambda x, t: torch.ones_like(x), start, 7), start + 1)
    errors = [(integrate_euler(lambda x, t: -x, start + 1, n) - np.exp(-1)).abs().max().item() for n in (20, 40)]
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.05)


@given(sigma=st.floats(0.01, 3), time=st.floats(0, 0.99))
def test_preconditioning_is_the_regression_of_the_target_on_a_gaussian_interpolant(sigma, time):
    """Cov(x1 - x0, x_t) / Var(x_t) and the residual deviation, for independent x0 ~ N(0,1), x1 ~ N(0,sigma^2)."""
    skip, scale_out, scale_in = gaussian_preconditioning(
        torch.tensor(time, dtype=torch.float64), torch.tensor(sigma, dtype=torch.float64)
    )
    variance = (1 - time) ** 2 + (time * sigma) ** 2
    covariance = time * sigma**2 - (1 - time)
    assert float(skip) == pytest.approx(covariance / variance, rel=1e-9)
    residual = 1 + sigma**2 - covariance**2 / variance
    assert float(scale_out) ** 2 == pytest.approx(residual, rel=1e-6)
    assert float(scale_in) ** 2 * variance == pytest.approx(1, rel=1e-9)
