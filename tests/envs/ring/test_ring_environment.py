"""The ring's episodes: dynamics, success, arena, restored states, vector environment, pictures."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import dualhead_envs  # noqa: F401  (registers the ids)
from dualhead_envs.ring.env import RotatingRingEnv
from dualhead_envs.ring.maps import REPRESENTATION_MAPS

REPRESENTATIONS = sorted(REPRESENTATION_MAPS)


def follow_expert(env, mode, seed=0):
    """Drive ``env`` along an expert's path; return the path and all that step returned."""
    observation, _ = env.reset(seed=seed)
    ring = env.unwrapped.ring
    path = ring.generator.draw_paths(np.random.default_rng(seed), observation["environment_state"], mode)
    commands = ring.map.from_position(path) if ring.control == "joint" else path
    return path, [env.step(command.astype(np.float32)) for command in commands]


@pytest.mark.parametrize("representation", REPRESENTATIONS)
@pytest.mark.parametrize("control", ["joint", "position"])
@pytest.mark.parametrize("n_modes", [2, 3, 4, 8])
def test_the_expert_succeeds_in_the_mode_it_means(n_modes, representation, control):
    env = gym.make(f"RotatingRing-v{n_modes}", representation=representation, control=control)
    for mode in range(n_modes):
        path, steps = follow_expert(env, mode, seed=mode)
        positions = np.array([observation["agent_pos"] for observation, *_ in steps])
        np.testing.assert_allclose(positions, path, atol=2e-6)
        rewards = [reward for _, reward, *_ in steps]
        assert rewards == [0.0] * 15 + [1.0]
        _, _, terminated, truncated, info = steps[-1]
        assert (terminated, truncated) == (True, True)
        assert info == {"is_success": True, "mode": mode, "collision": False}


def test_position_control_reaches_the_point_exactly():
    env = RotatingRingEnv(control="position")
    env.reset(seed=0)
    point = np.array([0.1, -0.7], dtype=np.float32)
    np.testing.assert_array_equal(env.step(point)[0]["agent_pos"], point)


def test_staying_at_home_fails_at_the_horizon():
    env = RotatingRingEnv(control="position")
    env.reset(seed=0)
    for step in range(16):
        _, reward, terminated, truncated, info = env.step(np.zeros(2))
        assert (reward, terminated, truncated) == (0.0, False, step == 15)
        assert info["mode"] == -1
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(2))


def test_leaving_the_arena_ends_the_episode_where_the_agent_was():
    env = RotatingRingEnv(control="position")
    env.reset(seed=0)
    env.step(np.array([0.5, 0.5]))
    observation, reward, terminated, truncated, info = env.step(np.array([10.1, 0.0]))
    np.testing.assert_array_equal(observation["agent_pos"], np.float32([0.5, 0.5]))
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert info["collision"] is True


def test_a_collision_at_the_last_step_is_no_success():
    env = RotatingRingEnv(control="position")
    observation, _ = env.reset(seed=0)
    for _ in range(15):
        *_, info = env.step(observation["environment_state"][:2] * observation["environment_state"][2])
    assert info["mode"] == 0
    _, reward, terminated, truncated, info = env.step(np.array([11.0, 0.0]))
    assert (reward, terminated, truncated, info["is_success"]) == (0.0, True, True, False)


@given(theta=st.floats(-10, 10), radius=st.floats(0.7, 1.3))
def test_a_recorded_condition_is_restored_to_the_last_bit(theta, radius):
    env = RotatingRingEnv()
    recorded, _ = env.reset(options={"state": {"theta": theta, "r": radius}})
    state = recorded["environment_state"]
    np.testing.assert_allclose(state, [np.cos(theta), np.sin(theta), radius], atol=1e-6)
    restored, _ = env.reset(seed=1, options={"state": {"environment_state": state}})
    np.testing.assert_array_equal(restored["environment_state"], state)
    assert env.observation_space.contains(restored)


@pytest.mark.parametrize(
    "options",
    [
        {"stat": {}},
        {"state": {}},
        {"state": 3.0},
        {"state": {"theta": 0.0}},
        {"state": {"theta": 0.0, "r": 2.0}},
        {"state": {"theta": np.nan, "r": 1.0}},
        {"state": {"environment_state": [1.0, 1.0, 1.0]}},
        {"state": {"environment_state": [1.0, 0.0]}},
        {"state": {"environment_state": np.ones((2, 3))}},
    ],
)
def test_reset_options_are_checked(options):
    with pytest.raises(ValueError, match=r"expected|condition"):
        RotatingRingEnv().reset(options=options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_modes": 1}, "n_modes=1"),
        ({"n_modes": 2.5}, "n_modes=2.5"),
        ({"representation": "cartesian"}, "representation='cartesian'"),
        ({"control": "pose"}, "control='pose'"),
        ({"mode_probabilities": [0.5, 0.4]}, "sum to 1"),
        ({"mode_probabilities": [1.5, -0.5]}, "sum to 1"),
        ({"mode_angles": [0.0, 2 * np.pi]}, "distinct"),
        ({"mode_angles": [0.0, 1.0, 2.0]}, "2 finite angles"),
        ({"path_spread": -0.1}, "path_spread=-0.1"),
        ({"tau": 0.0}, "tau=0.0"),
    ],
)
def test_bad_arguments_are_refused_by_name(arguments, message):
    with pytest.raises(ValueError, match=message):
        RotatingRingEnv(**arguments)


def test_unequal_spacing_moves_the_modes():
    env = RotatingRingEnv(n_modes=3, control="position", mode_angles=[0.0, 1.0, 2.5])
    observation, _ = env.reset(seed=0, options={"state": {"theta": 0.0, "r": 1.0}})
    for _ in range(16):
        *_, info = env.step(np.array([np.cos(2.5), np.sin(2.5)]))
    assert info["mode"] == 2
    assert observation["environment_state"][0] == 1.0


@pytest.mark.parametrize("n_modes", [2, 4])
@pytest.mark.parametrize(("representation", "control"), [("nullspace", "joint"), ("polar", "position")])
def test_native_vector_environment_is_gymnasiums_own_step_by_step(n_modes, representation, control):
    arguments = {"num_envs": 5, "representation": representation, "control": control}
    native = gym.make_vec(f"RotatingRing-v{n_modes}", **arguments)
    reference = gym.make_vec(f"RotatingRing-v{n_modes}", vectorization_mode="sync", **arguments)
    assert native.metadata["autoreset_mode"] == reference.metadata["autoreset_mode"]
    assert native.single_action_space == reference.single_action_space
    assert native.observation_space == reference.observation_space
    rng = np.random.default_rng(0)
    compare = np.testing.assert_equal
    compare(native.reset(seed=11), reference.reset(seed=11))
    for step in range(60):
        # Some copies leave the arena, so that their episodes begin at different times.
        actions = rng.normal(0, 0.5, native.action_space.shape).astype(np.float32)
        actions[rng.random(5) < 0.03] = 50.0
        compare(native.step(actions), reference.step(actions), err_msg=f"step {step}")
    compare(native.reset(seed=[5, None, 7, 8, 9]), reference.reset(seed=[5, None, 7, 8, 9]))


def test_vector_environment_restores_one_state_a_copy():
    env = gym.make_vec("RotatingRing-v3", num_envs=4)
    theta = np.arange(4.0)
    observation, info = env.reset(options={"state": {"theta": theta, "r": np.ones(4)}})
    np.testing.assert_allclose(observation["environment_state"][:, 1], np.sin(theta), atol=1e-7)
    assert not info["is_success"].any()
    with pytest.raises(ValueError, match="one or 4"):
        env.reset(options={"state": {"theta": np.arange(3.0), "r": 1.0}})
    with pytest.raises(ValueError, match="3 seeds"):
        env.reset(seed=[1, 2, 3])


@pytest.mark.parametrize("actions", [np.zeros((3, 2)), np.zeros(2), np.full((4, 2), np.nan), np.zeros((4, 3))])
def test_vector_environment_refuses_bad_actions(actions):
    env = gym.make_vec("RotatingRing-v2", num_envs=4)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="expected"):
        env.step(actions)


@given(hnp.arrays(np.float32, (16, 2), elements=st.floats(-9, 9, width=32)))
@settings(max_examples=30)
def test_the_mode_in_info_is_the_partitions_label_of_the_measured_path(path):
    env = RotatingRingEnv(n_modes=4, control="position")
    observation, _ = env.reset(seed=0)
    measured = []
    for point in path:
        following, *_, info = env.step(point)
        measured.append(following["agent_pos"])
        assert info["mode"] == env.mode_partition.assign(measured, observation["environment_state"])
    assert info["is_success"] == (info["mode"] >= 0)


def test_the_picture_shows_the_path_and_needs_an_episode():
    env = gym.make("RotatingRing-v8", render_mode="rgb_array", control="position").unwrapped
    with pytest.raises(gym.error.ResetNeeded):
        env.render()
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (480, 480, 3)
    assert before.dtype == np.uint8
    env.step(np.array([5.0, -9.0]))  # beyond the picture's edge
    after = env.render()
    assert (before != after).any(axis=-1).sum() > 500
    np.testing.assert_array_equal(after, env.render())


def test_vector_environment_draws_every_copy():
    env = gym.make_vec("RotatingRing-v3", num_envs=2, render_mode="rgb_array")
    env.reset(seed=0)
    first, second = env.render()
    assert first.shape == (480, 480, 3)
    assert (first != second).any()
