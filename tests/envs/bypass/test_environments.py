"""Episodes of the two bypass environments: how they begin, end, repeat and refuse."""

import os
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import dualhead_envs  # noqa: F401  (registers the ids)
from dualhead_envs.bypass.demonstrations import demonstrate_modes
from dualhead_envs.bypass.environment import MAX_EPISODE_STEPS

IDS = ("BimodalBypass-v2", "RotatingBypass-v3")


@pytest.fixture(scope="module", params=IDS)
def env_id(request):
    return request.param


@pytest.fixture(scope="module")
def expert(env_id):
    return gym.make(env_id, control="pose").unwrapped


@pytest.fixture(scope="module")
def pair(expert):
    return demonstrate_modes(expert, seed=3)


def replay(env, demonstration, state=None):
    """Errors (mm) of the grip site against the same-index state, and the last info."""
    state = state or {"environment_state": demonstration.environment_state[0]}
    env.reset(options={"state": state})
    indices = env.layout.control_indices(env.control)
    errors = []
    for action in demonstration.actions():
        observation, reward, terminated, _, info = env.step(action[indices])
        errors.append(1e3 * np.linalg.norm(observation["agent_pos"][14:17] - action[7:10]))
        assert reward == float(info["is_success"])
        if terminated:
            break
    return np.array(errors), info


def test_both_modes_succeed_without_touching_the_obstacle(pair):
    assert pair.success
    assert all(demonstration.clearance > 0.020 for demonstration in pair.demonstrations)


@pytest.mark.parametrize(("control", "limit"), [("joint", 4.0), ("position", 6.0), ("pose", 6.0)])
def test_a_demonstrations_own_states_lead_to_the_goal_under_every_control(env_id, pair, control, limit):
    env = gym.make(env_id, control=control, tau=0.11).unwrapped
    for mode, demonstration in enumerate(pair.demonstrations):
        errors, info = replay(env, demonstration)
        expected = {"is_success": True, "mode": mode, "collision": False, "failure": "none", "onset": -1}
        assert info == expected
        assert errors.mean() < limit


def test_targets_lag_without_feed_forward(env_id, pair):
    with_it, without = (
        replay(gym.make(env_id, control="position", feed_forward=feed_forward).unwrapped, pair.demonstrations[0])
        for feed_forward in (True, False)
    )
    assert without[0].mean() > 3 * with_it[0].mean()


def test_positions_are_the_forward_kinematics_of_the_joints(expert, pair):
    simulation = expert.simulation
    for demonstration in pair.demonstrations:
        for action in demonstration.actions():
            simulation.joints[:] = action[:7]
            simulation.update_kinematics()
            assert np.linalg.norm(simulation.position - action[7:10]) < 1e-4
            np.testing.assert_allclose(simulation.rotation[:, :2].T.ravel(), action[10:16], atol=1e-5)


def test_running_into_the_obstacle_ends_the_episode(env_id):
    env = gym.make(env_id, control="position").unwrapped
    observation, info = env.reset(seed=0)
    position, goal = observation["agent_pos"][14:17], np.array([0.07, 0.0, 0.95])
    for step in range(60):
        action = np.append(position + min(1.0, step / 30) * (goal - position), -1.0)
        _, reward, terminated, truncated, info = env.step(action)
        if terminated:
            break
    assert info["collision"]
    assert (reward, terminated, truncated, info["is_success"]) == (0.0, True, False, False)
    with pytest.raises(gym.error.ResetNeeded, match="reset"):
        env.step(action)


@pytest.mark.parametrize("control", ["joint", "position", "pose"])
@pytest.mark.parametrize("size", [1.0, 1e3, 1e150])
def test_wild_targets_move_the_robot_no_faster_than_it_may(env_id, control, size):
    env = gym.make(env_id, control=control).unwrapped
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(40):
        observation, _, terminated, _, _ = env.step(size * rng.normal(size=env.action_space.shape))
        assert np.isfinite(observation["agent_pos"]).all()
        if control == "joint":
            assert np.abs(observation["agent_pos"][7:14]).max() < 6.0, "rad/s"
        if terminated:
            env.reset()


def test_an_idle_episode_is_truncated_at_the_registered_horizon(env_id):
    env = gym.make(env_id)
    assert env.spec.max_episode_steps == MAX_EPISODE_STEPS
    observation, _ = env.reset(seed=0)
    hold = np.append(observation["agent_pos"][:7], 0.0)
    for _ in range(MAX_EPISODE_STEPS):
        observation, _, terminated, truncated, info = env.step(hold)
    assert (terminated, truncated, info["is_success"], info["mode"]) == (False, True, False, -1)
    np.testing.assert_allclose(observation["agent_pos"][:7], hold[:7], atol=1e-3)


def test_episodes_start_apart_and_inside_their_ranges(env_id):
    env = gym.make(env_id).unwrapped
    starts = np.array([env.reset(seed=seed)[0]["environment_state"] for seed in range(50)])
    (x_low, x_high), (y_low, y_high) = env.bypass.cube_x, env.bypass.cube_y
    assert ((x_low <= starts[:, 0]) & (starts[:, 0] <= x_high)).all()
    assert ((y_low <= starts[:, 1]) & (starts[:, 1] <= y_high)).all()
    assert len(np.unique(starts[:, :2], axis=0)) == 50
    if env_id == "RotatingBypass-v3":
        radius, cosine, sine = starts[:, 18:].T
        assert ((radius >= 0.170) & (radius <= 0.215)).all()
        np.testing.assert_allclose(np.hypot(cosine, sine), 1.0, atol=1e-6)
        assert (cosine >= 0).all()
        assert (sine >= 0).all()


def test_the_condition_does_not_tell_which_route_was_drawn_first(expert, env_id):
    if env_id == "BimodalBypass-v2":
        return
    drawn = []
    for seed in range(200):
        observation, _ = expert.reset(seed=seed)
        initial = expert.initial_state
        assert 0 <= initial.phi < np.pi / 2
        np.testing.assert_allclose(observation["environment_state"][19], np.cos(initial.phi), atol=1e-6)
        drawn.append(initial.route_azimuth >= np.pi / 2)
    assert 0.35 < np.mean(drawn) < 0.65


def test_a_seed_repeats_after_any_number_of_resets(env_id, pair):
    env = gym.make(env_id, control="joint").unwrapped
    actions = pair.demonstrations[0].actions()[:, env.layout.control_indices("joint")]

    def run():
        observation, _ = env.reset(seed=3)
        returned = [observation, *(env.step(action)[0] for action in actions[:60])]
        return b"".join(o[key].tobytes() for o in returned for key in sorted(o))

    first = run()
    for seed in range(5):
        env.reset(seed=seed)
        env.step(actions[0])
    assert run() == first


@pytest.mark.parametrize("control", ["joint", "pose"])
def test_a_state_restores_the_rest_of_an_episode_bit_for_bit(env_id, pair, control):
    env = gym.make(env_id, control=control).unwrapped
    actions = pair.demonstrations[1].actions()[:, env.layout.control_indices(control)]
    env.reset(seed=3)
    for action in actions[:90]:
        env.step(action)
    state = env.state()
    continued = [env.step(action) for action in actions[90:120]]
    other = gym.make(env_id, control=control).unwrapped
    observation, info = other.reset(options={"state": state})
    assert info["mode"] == int(state["mode"][0]) or info["mode"] == -1
    for action, expected in zip(actions[90:120], continued, strict=True):
        observation, *rest = other.step(action)
        for key, values in observation.items():
            np.testing.assert_array_equal(values, expected[0][key])
        assert tuple(rest) == expected[1:]


def test_a_recorded_first_frame_restores_the_initial_state(env_id):
    env = gym.make(env_id).unwrapped
    first, _ = env.reset(seed=11)
    env.reset(seed=12)
    again, _ = env.reset(options={"state": {"environment_state": first["environment_state"]}})
    for key in first:
        np.testing.assert_allclose(again[key], first[key], atol=1e-6)


def test_states_of_other_environments_are_refused(env_id):
    other_id = IDS[1 - IDS.index(env_id)]
    env, other, ring = (gym.make(name).unwrapped for name in (env_id, other_id, "RotatingRing-v2"))
    env.reset(seed=0)
    observation, _ = other.reset(seed=0)
    ring_observation, _ = ring.reset(seed=0)
    for state, words in (
        (other.state(), other_id),
        ({"environment_state": observation["environment_state"]}, "expected"),
        ({"environment_state": ring_observation["environment_state"]}, "expected"),
        ({**env.state(), "physics": np.zeros(3)}, "physics"),
        ({"theta": 0.0, "r": 1.0}, "expected"),
        (np.zeros(50), "expected"),
    ):
        with pytest.raises(ValueError, match=words) as error:
            env.reset(options={"state": state})
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="only option is 'state'"):
        env.reset(options={"seed": 3})


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"control": "velocity"}, "joint.*pose.*position"),
        ({"render_mode": "human"}, "rgb_array"),
        ({"image_size": (0, 10)}, "image_size"),
        ({"tau": -0.1}, "tau"),
    ],
)
def test_bad_arguments_are_one_sentence(env_id, settings, words):
    with pytest.raises(ValueError, match=words) as error:
        gym.make(env_id, **settings)
    assert "\n" not in str(error.value)


def test_a_rotation_that_is_none_is_refused(env_id):
    env = gym.make(env_id, control="pose").unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match="does not span a plane"):
        env.step(np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 1.0]))


def test_state_only_work_opens_no_gl_and_leaves_numpys_generator_alone(env_id):
    code = f"""
import sys, os, hashlib
import numpy as np
before = hashlib.sha256(np.random.get_state()[1].tobytes()).hexdigest()
import gymnasium as gym
env = gym.make("dualhead_envs:{env_id}", render_mode="rgb_array")
env.reset(seed=0)
env.step(env.action_space.sample())
assert hashlib.sha256(np.random.get_state()[1].tobytes()).hexdigest() == before
assert "OpenGL" not in sys.modules and "MUJOCO_GL" not in os.environ
assert "torch" not in sys.modules and "robosuite" not in sys.modules
"""
    environment = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, capture_output=True)
