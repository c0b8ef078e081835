"""The scripted expert's path: critically damped where it must not overshoot, under-damped where it shall."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dualhead_envs.bypass.controllers import ROBOSUITE_STIFFNESS
from dualhead_envs.bypass.demonstrations import apex_miss
from dualhead_envs.bypass.demonstrator import damped
from dualhead_envs.bypass.simulation import CONTROL_PERIOD


@pytest.mark.parametrize("zeta", [0.4, 0.83, 1.0])
def test_the_smoothing_solves_its_differential_equation(zeta):
    goals = np.random.default_rng(0).normal(size=12)
    state, path = np.zeros(2), []
    for goal in goals:
        solution = solve_ivp(
            lambda _, s, goal=goal: [
                s[1], ROBOSUITE_STIFFNESS * (goal - s[0]) - 2 * zeta * np.sqrt(ROBOSUITE_STIFFNESS) * s[1],
            ],
            (0.0, CONTROL_PERIOD), state, rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        state = solution.y[:, -1]
        path.append(state[0])
    np.testing.assert_allclose(damped(goals[:, None], np.zeros(1), np.full(12, zeta))[:, 0], path, atol=1e-8)


def test_only_an_under_damped_hand_runs_past_its_goal():
    goals = np.ones((40, 1))
    assert damped(goals, np.zeros(1), np.ones(40)).max() <= 1.0
    # A second-order system's overshoot after a step, in shares of it.
    expected = np.exp(-np.pi * 0.83 / np.sqrt(1 - 0.83**2))
    assert damped(goals, np.zeros(1), np.full(40, 0.83)).max() - 1 == pytest.approx(expected, rel=0.1)


def test_the_miss_of_an_apex_is_signed_by_which_side_of_it_the_path_turns():
    apex = np.array([0.18, 0.955])
    out = np.array([[0.0, 0.955], [0.184, 0.955], [0.1, 0.955]])
    assert apex_miss(out, apex) == pytest.approx((0.004, 0.004))
    assert apex_miss(out - [0.01, 0.0], apex) == pytest.approx((0.006, -0.006))
