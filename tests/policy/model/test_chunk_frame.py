"""The chunk frame changes coordinates, not the problem."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sklearn.linear_model import Ridge

from dualhead_policy.flow.flow_matching import integrate_euler
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.model.chunk_frame import RIDGE, ChunkFrame


@pytest.fixture
def windows():
    """Observations and chunks that they explain in part, and a frame fitted to them."""
    generator = keyed_generator(0)
    observation = torch.randn(500, 3, generator=generator, dtype=torch.float64)
    mixing = torch.randn(3, 8, generator=generator, dtype=torch.float64)
    scatter = torch.randn(2, 8, generator=generator, dtype=torch.float64)
    chunk = observation @ mixing + torch.randn(500, 2, generator=generator, dtype=torch.float64) @ scatter + 1
    return observation, chunk, ChunkFrame(3, 8).double().fit(observation, chunk)


def test_the_mean_is_scikit_learns_ridge_regression(windows):
    observation, chunk, frame = windows
    ridge = Ridge(alpha=RIDGE * len(observation)).fit(observation.numpy(), chunk.numpy())
    assert frame.mean(observation).numpy() == pytest.approx(ridge.predict(observation.numpy()), abs=1e-9)


def test_in_the_frame_the_coordinates_are_uncorrelated_with_the_stated_spread(windows):
    observation, chunk, frame = windows
    inside = frame.enter(chunk, observation)
    covariance = np.cov(inside.T.numpy(), ddof=0)
    assert covariance == pytest.approx(np.diag(frame.spread.numpy() ** 2), abs=1e-9)
    # Two directions remain when the observation's part is taken off.
    assert (frame.spread > 1e-2).sum() == 2


def test_leaving_undoes_entering(windows):
    observation, chunk, frame = windows
    assert torch.allclose(frame.leave(frame.enter(chunk, observation), observation), chunk)
    several = frame.enter(chunk, observation)[:, None].expand(-1, 4, -1)
    assert torch.allclose(frame.leave(several, observation)[:, 3], chunk)


def test_a_regression_error_is_the_same_in_and_out_of_the_frame(windows):
    """|v_y - (y_1 - y_0)| = |v_x - (x_1 - x_0)| for the velocity that the frame maps to the other."""
    observation, chunk, frame = windows
    noise, velocity = torch.randn_like(chunk), torch.randn_like(chunk)
    inside = (velocity - frame.mean(observation)) @ frame.basis
    error_inside = inside - (frame.enter(chunk, observation) - frame.rotate(noise))
    assert torch.allclose(error_inside.norm(dim=1), (velocity - (chunk - noise)).norm(dim=1))


def test_euler_takes_the_same_steps_in_and_out_of_the_frame(windows):
    observation, chunk, frame = windows
    noise = torch.randn_like(chunk)
    mean = frame.mean(observation)

    def outside(x, time):
        return (x * 0.3).sin() + time

    def inside(y, time):
        return (outside(y @ frame.basis.T + time * mean, time) - mean) @ frame.basis

    samples = frame.leave(integrate_euler(inside, frame.rotate(noise), 7), observation)
    assert torch.allclose(samples, integrate_euler(outside, noise, 7))


def test_noise_on_the_observation_widens_the_frame(windows):
    observation, chunk, frame = windows
    noisy = ChunkFrame(3, 8).double().fit(observation, chunk, noise=0.5)
    assert noisy.spread.square().sum() > frame.spread.square().sum()
    assert noisy.slope.norm() < frame.slope.norm()
