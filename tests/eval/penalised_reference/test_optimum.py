"""The optimum under endpoint consistency: no other pair of functions does better, whatever finds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.penalised_reference.conditional_expectation import Resolution
from dualhead_eval.penalised_reference.optimum import PenalisedOptimum
from dualhead_eval.penalised_reference.two_mode_pair import TwoModePair


def two_modes(beta=0.0, log_odds=0.0):
    """Head A with three coordinates, head B with two, neither map nor covariance diagonal."""
    kinematics = np.array([[0.8, -0.5, 0.3], [0.1, 0.9, -0.6]])
    half_a = np.array([1.5, -1.2, 0.4])
    spread = np.array([[0.5, 0.1], [-0.2, 0.3], [0.1, 0.2]])
    covariance_a = spread @ spread.T
    return TwoModePair(
        half_a=half_a,
        half_b=kinematics @ half_a,
        kinematics=kinematics,
        covariance_a=covariance_a,
        covariance_b=kinematics @ covariance_a @ kinematics.T,
        covariance_ab=covariance_a @ kinematics.T,
        noise_ab=(1 - beta) * np.eye(3, 2),
        log_odds=log_odds,
        loss_ratio=2 / 3,
    )


def draw(pair, time, n, seed):
    """Clean and noisy chunks (X_A, X_B, x_t^A, x_t^B) of n samples."""
    rng = np.random.default_rng(seed)
    sign = np.where(rng.random(n) < 1 / (1 + np.exp(-pair.log_odds)), 1, -1)[:, None]
    data = np.block([[pair.covariance_a, pair.covariance_ab], [pair.covariance_ab.T, pair.covariance_b]])
    width = len(pair.half_a)
    clean = sign * np.concatenate([pair.half_a, pair.half_b]) + rng.multivariate_normal(
        np.zeros(len(data)), data, n, method="eigh"
    )
    unit = np.block([[np.eye(width), pair.noise_ab], [pair.noise_ab.T, np.eye(len(pair.half_b))]])
    source = rng.multivariate_normal(np.zeros(len(unit)), unit, n, method="eigh")
    noisy = time * clean + (1 - time) * source
    return clean[:, :width], clean[:, width:], noisy[:, :width], noisy[:, width:]


def loss(pair, time, weight, samples, a, b):
    """The training loss at one time, from the velocities themselves."""
    clean_a, clean_b, x_a, x_b = samples
    velocity_a, velocity_b = (a - x_a) / (1 - time), (b - x_b) / (1 - time)
    target_a, target_b = (clean_a - x_a) / (1 - time), (clean_b - x_b) / (1 - time)
    flow = np.square(velocity_a - target_a).mean(axis=1) + np.square(velocity_b - target_b).mean(axis=1)
    return flow + weight * np.square(a @ pair.kinematics.T - b).mean(axis=1)


def least_squares(pair, time, weight, seed=0, n=8_000, features=60):
    """Oracle: the minimum of the loss over many basis functions, fitted to samples; no grid and no Gaussian algebra."""
    clean_a, clean_b, x_a, x_b = draw(pair, time, n, seed)
    rng = np.random.default_rng(seed + 1)

    def basis(width):
        slope, offset = 1.5 * rng.standard_normal((width, features)), 2 * rng.standard_normal(features)
        return lambda x: np.concatenate([np.ones((len(x), 1)), x, np.tanh(x @ slope + offset)], axis=1)

    basis_a, basis_b = basis(x_a.shape[1]), basis(x_b.shape[1])
    phi_a, phi_b = basis_a(x_a), basis_b(x_b)
    g, d_a, d_b = pair.kinematics, x_a.shape[1], x_b.shape[1]
    flow = 1 / (1 - time) ** 2
    normal = np.block(
        [
            [
                np.kron(flow / d_a * np.eye(d_a) + weight / d_b * g.T @ g, phi_a.T @ phi_a),
                np.kron(-weight / d_b * g.T, phi_a.T @ phi_b),
            ],
            [
                np.kron(-weight / d_b * g, phi_b.T @ phi_a),
                np.kron((flow + weight) / d_b * np.eye(d_b), phi_b.T @ phi_b),
            ],
        ]
    )
    right = np.concatenate([flow / d_a * (phi_a.T @ clean_a).T.ravel(), flow / d_b * (phi_b.T @ clean_b).T.ravel()])
    solution = np.linalg.solve(normal + 1e-6 * n * np.eye(len(normal)), right)
    cut = d_a * phi_a.shape[1]
    weights_a, weights_b = solution[:cut].reshape(d_a, -1).T, solution[cut:].reshape(d_b, -1).T
    return lambda x_a, x_b: (basis_a(x_a) @ weights_a, basis_b(x_b) @ weights_b)


@pytest.mark.parametrize(("time", "weight", "beta", "log_odds"), [(0.3, 3.0, 0.0, 0.0), (0.4, 20.0, 0.3, 0.8)])
def test_least_squares_over_many_basis_functions_comes_close_and_never_below(time, weight, beta, log_odds):
    pair = two_modes(beta, log_odds)
    optimum = PenalisedOptimum(pair, time, weight)
    samples = draw(pair, time, 10_000, seed=7)
    ours = optimum.endpoint_a(samples[2]), optimum.endpoint_b(samples[3])
    oracle = least_squares(pair, time, weight)(samples[2], samples[3])
    difference = loss(pair, time, weight, samples, *oracle) - loss(pair, time, weight, samples, *ours)
    error = difference.std() / len(difference) ** 0.5
    assert difference.mean() > -3 * error
    assert difference.mean() < 0.02 * loss(pair, time, weight, samples, *ours).mean()
    for mine, other, half in zip(ours, oracle, (pair.half_a, pair.half_b), strict=True):
        assert np.square(mine - other).mean() ** 0.5 < 0.1 * np.abs(half).max()


@pytest.mark.parametrize("beta", [0.0, 0.5])
def test_no_function_of_a_heads_own_chunk_is_left_to_improve_it(beta):
    """The first-order condition (2): the loss's gradient at the optimum has no component along any test function."""
    pair, time, weight = two_modes(beta), 0.35, 5.0
    optimum = PenalisedOptimum(pair, time, weight)
    clean_a, clean_b, x_a, x_b = draw(pair, time, 20_000, seed=3)
    a, b = optimum.endpoint_a(x_a), optimum.endpoint_b(x_b)
    w, gap = weight * (1 - time) ** 2, a @ pair.kinematics.T - b
    gradients = pair.loss_ratio * (a - clean_a) + w * gap @ pair.kinematics, (b - clean_b) - w * gap
    for x, gradient in zip((x_a, x_b), gradients, strict=True):
        tests = [np.ones(len(x)), *x.T, *np.tanh(2 * x).T, np.cos(3 * x.sum(axis=1)), np.sign(x[:, 0] * x[:, 1])]
        for test in tests:
            product = gradient * test[:, None]
            assert (np.abs(product.mean(axis=0)) < 4.5 * product.std(axis=0) / len(x) ** 0.5).all()


@pytest.mark.parametrize("beta", [0.0, 0.5])
def test_head_a_expects_of_head_b_what_a_regression_on_samples_finds(beta):
    pair, time = two_modes(beta), 0.35
    optimum = PenalisedOptimum(pair, time, 5.0)
    *_, x_a, x_b = draw(pair, time, 20_000, seed=6)
    error = optimum.endpoint_b(x_b) - optimum.expected_b(x_a)
    for test in (np.ones(len(x_a)), *x_a.T, *np.tanh(2 * x_a).T):
        product = error * test[:, None]
        assert (np.abs(product.mean(axis=0)) < 4.5 * product.std(axis=0) / len(x_a) ** 0.5).all()


def test_the_solution_does_not_depend_on_the_grid():
    pair, time, weight = two_modes(), 0.35, 3.0
    *_, x_a, x_b = draw(pair, time, 1_000, seed=1)
    coarse, fine = (PenalisedOptimum(pair, time, weight, Resolution(*size)) for size in ((0.7, 5), (0.4, 7)))
    assert np.sqrt(np.square(coarse.endpoint_a(x_a) - fine.endpoint_a(x_a)).mean()) < 0.01
    assert np.sqrt(np.square(coarse.endpoint_b(x_b) - fine.endpoint_b(x_b)).mean()) < 0.01


def test_a_large_weight_brings_the_endpoints_together():
    pair, time = two_modes(), 0.3
    *_, x_a, x_b = draw(pair, time, 1_000, seed=2)
    gaps = []
    for weight in (0.0, 3.0, 300.0):
        optimum = PenalisedOptimum(pair, time, weight)
        gaps.append(np.square(optimum.endpoint_a(x_a) @ pair.kinematics.T - optimum.endpoint_b(x_b)).mean())
    assert gaps[0] > 2 * gaps[1] > 8 * gaps[2]


def test_at_the_first_step_nothing_is_known_and_both_heads_predict_the_mean():
    pair = two_modes(log_odds=0.7)
    optimum = PenalisedOptimum(pair, 0.0, 3.0)
    x = np.random.default_rng(0).standard_normal((50, 3))
    mean = np.tanh(0.35)
    assert np.allclose(optimum.endpoint_a(x), mean * pair.half_a, atol=1e-5)
    assert np.allclose(optimum.endpoint_b(x[:, :2]), mean * pair.half_b, atol=1e-5)


def test_what_head_a_can_do_without_moving_the_position_is_left_alone():
    """A direction in the kernel of G keeps its own posterior mean at any weight."""
    pair, time = two_modes(), 0.4
    kernel = np.linalg.svd(pair.kinematics)[2][2]
    *_, x_a, _ = draw(pair, time, 500, seed=4)
    free, bound = (PenalisedOptimum(pair, time, weight).endpoint_a(x_a) @ kernel for weight in (0.0, 10.0))
    assert np.allclose(free, bound, atol=1e-6)


def test_modes_without_width_are_solved_too():
    pair = two_modes()
    points = replace(pair, covariance_a=0 * pair.covariance_a, covariance_b=0 * pair.covariance_b)
    points = replace(points, covariance_ab=0 * pair.covariance_ab)
    optimum = PenalisedOptimum(points, 0.9, 3.0)
    *_, x_a, x_b = draw(points, 0.9, 200, seed=5)
    assert optimum.slice.left_out < 1e-9
    assert np.allclose(np.abs(optimum.endpoint_b(x_b)), np.abs(points.half_b), atol=1e-3)
    assert np.allclose(np.abs(optimum.endpoint_a(x_a)), np.abs(points.half_a), atol=1e-3)
