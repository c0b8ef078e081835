"""Euler integration of both heads from noise to chunks along the optimum's velocity v = (a - x_t) / (1 - t)."""

from __future__ import annotations

import numpy as np

from dualhead_eval.penalised_reference.conditional_expectation import Resolution
from dualhead_eval.penalised_reference.optimum import PenalisedOptimum, linear_part
from dualhead_eval.penalised_reference.two_mode_pair import TwoModePair


def integrate_modes(
    pair: TwoModePair,
    noise_a: np.ndarray,
    noise_b: np.ndarray,
    consistency_weight: float,
    num_steps: int,
    resolution: Resolution,
    centre_a: np.ndarray | float = 0.0,
    centre_b: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Both heads' chunks from their noise.

    Args:
        pair: The joint law, centred.
        noise_a, noise_b: x_0 of head A (P, n_A) and head B (P, n_B).
        consistency_weight: lambda.
        num_steps: Euler steps.
        resolution: Of the numerical solution.
        centre_a, centre_b: The points half-way between the modes, (n_A,) and (n_B,).
    """
    x_a, x_b = noise_a, noise_b
    for step in range(num_steps):
        time = step / num_steps
        optimum = PenalisedOptimum(pair, time, consistency_weight, resolution)
        part = 1 / (num_steps - step)  # dt / (1 - t)
        x_a = x_a + part * (centre_a + optimum.endpoint_a(x_a - time * centre_a) - x_a)
        x_b = x_b + part * (centre_b + optimum.endpoint_b(x_b - time * centre_b) - x_b)
    return x_a, x_b


def integrate_gaussian(
    pair: TwoModePair, noise_a: np.ndarray, noise_b: np.ndarray, consistency_weight: float, num_steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """As :func:`integrate_modes` for a pair whose modes are one centred Gaussian; noise (..., n_A) and (..., n_B)."""
    x_a, x_b = noise_a, noise_b
    for step in range(num_steps):
        linear_a, linear_b = linear_part(pair, step / num_steps, consistency_weight)
        part = 1 / (num_steps - step)
        x_a = x_a + part * (x_a @ linear_a.T - x_a)
        x_b = x_b + part * (x_b @ linear_b.T - x_b)
    return x_a, x_b
