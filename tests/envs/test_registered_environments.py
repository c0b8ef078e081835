"""What every registered environment owes to Gymnasium: one test body over every id."""

import hashlib
import json
import pickle
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dualhead_envs import ENVIRONMENTS

IDS = sorted(ENVIRONMENTS)
# Advice that Gymnasium's own test suite sets aside, too: our actions are metres and radians, not shares of
# a range, and a velocity that no one bounds has infinite bounds.
ADVICE = ".*(recommend using a symmetric and normalized space|value is -?infinity).*"


@pytest.fixture(params=IDS)
def env(request):
    env = gym.make(f"dualhead_envs:{request.param}")
    yield env
    env.close()


def assert_equal(a, b):
    """Equality to the last bit of nested dictionaries, tuples and arrays."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_equal(a[key], b[key])
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_equal(x, y)
    else:
        assert type(a) is type(b)
        np.testing.assert_array_equal(a, b)


def small_actions(env, steps, seed=0):
    """Random actions of a tenth of the space's size, inside it."""
    space = env.action_space
    draws = np.random.default_rng(seed).uniform(-0.1, 0.1, (steps, *space.shape))
    middle, half = (space.low + space.high) / 2, (space.high - space.low) / 2
    return (middle + half * draws).astype(np.float32)


def episode(env, seed, steps=8):
    """Everything that an environment returns at a reset and in a few steps."""
    returned = [env.reset(seed=seed)]
    for action in small_actions(env, steps):
        returned.append(env.step(action))
        if returned[-1][2] or returned[-1][3]:
            break
    return returned


def digest(env):
    observations = [returned[0] for returned in episode(env, seed=7)]
    content = b"".join(observation[key].tobytes() for observation in observations for key in sorted(observation))
    return hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("env_id", IDS)
def test_making_an_environment_warns_of_nothing(env_id):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym.make(env_id).close()
        gym.make(f"dualhead_envs:{env_id}").close()


def test_gymnasium_checker_is_content(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=ADVICE)
        # Rendering is tested where the renderer is; a machine without OpenGL runs this test as well.
        check_env(env.unwrapped, skip_render_check="Ring" not in env.spec.id)


def test_two_environments_stay_in_lock_step(env):
    other = gym.make(env.spec.id)
    for seed in (0, 1):
        for a, b in zip(episode(env, seed), episode(other, seed), strict=True):
            assert_equal(a, b)
    other.close()


def test_a_pickled_copy_stays_in_lock_step(env):
    env.reset(seed=0)
    copy = pickle.loads(pickle.dumps(env))
    for a, b in zip(episode(env, 3), episode(copy, 3), strict=True):
        assert_equal(a, b)
    copy.close()


def test_different_seeds_begin_differently(env):
    first, _ = env.reset(seed=0)
    second, _ = env.reset(seed=1)
    assert any(not np.array_equal(first[key], second[key]) for key in first)


def test_a_seed_means_the_same_in_another_process(env):
    code = (
        "import sys, gymnasium as gym; sys.path.insert(0, sys.argv[2])\n"
        "from test_registered_environments import digest\n"
        "print(digest(gym.make(f'dualhead_envs:{sys.argv[1]}')))"
    )
    folder = __file__.rpartition("/")[0]
    command = [sys.executable, "-c", code, env.spec.id, folder]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    assert answer.stdout.split()[-1] == digest(env)


def test_info_says_success_mode_and_collision_from_the_start(env):
    for returned in episode(env, seed=0):
        info = returned[-1]
        assert type(info["is_success"]) is bool
        assert type(info["collision"]) is bool
        assert type(info["mode"]) is int
        assert -1 <= info["mode"] < env.unwrapped.mode_partition.n_modes


def test_docstring_tables_list_every_dimension_of_the_layout(env):
    layout = env.unwrapped.layout
    for dimension in (*layout.agent_pos, *layout.environment_state):
        assert f"| {dimension.name} | {dimension.unit} |" in type(env.unwrapped).__doc__


def test_the_partition_describes_itself_in_json(env):
    partition = env.unwrapped.mode_partition
    assert json.loads(json.dumps(partition.to_dict())) == partition.to_dict()
    assert partition.to_dict()["n_modes"] == partition.n_modes


@pytest.mark.parametrize(
    "spoil",
    [
        lambda action: action * np.nan,
        lambda action: action + np.inf,
        lambda action: action[:-1],
        lambda _: 0.0,
    ],
    ids=["NaN", "infinity", "too short", "a scalar"],
)
def test_a_bad_action_is_one_clear_sentence(env, spoil):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="expected") as error:
        env.unwrapped.step(spoil(env.action_space.sample()))
    assert "\n" not in str(error.value)


def test_lerobot_finds_what_it_asks_for(env):
    assert env.get_wrapper_attr("_max_episode_steps") == env.spec.max_episode_steps
    assert env.get_wrapper_attr("task") == env.spec.id
    assert env.get_wrapper_attr("task_description").endswith(".")


def test_a_window_is_refused_with_a_sentence(env):
    with pytest.raises(ValueError, match="render_mode='human'"):
        gym.make(env.spec.id, render_mode="human")
