"""Perturbed episodes: what each kind does, that it repeats by seed, and that it leaves the rest alone."""

import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import dualhead_envs  # noqa: F401  (registers the ids)
from dualhead_envs.bypass.demonstrations import demonstrate_modes
from dualhead_envs.bypass.perturbations.levels import LEVELS
from dualhead_envs.bypass.perturbations.perturbation import KINDS, parse_perturbation

IDS = ("BimodalBypass-v2", "RotatingBypass-v3")
EXAMPLES = {
    "cube_bias": 0.03, "joint_bias": 0.06, "noise": 0.03, "push": 120, "slip": 6, "delay": 2, "payload": 4,
    "friction": 0.3, "obstacle": 0.06, "goal": 0.06,
}  # fmt: skip
NAMES = [f"{kind}:{severity}" for kind, severity in EXAMPLES.items()]
ADVICE = ".*(recommend using a symmetric and normalized space|value is -?infinity).*"


@pytest.fixture(scope="module")
def actions():
    """A demonstration of v2 from seed 3, under joint control."""
    expert = gym.make("BimodalBypass-v2", control="pose").unwrapped
    dual = demonstrate_modes(expert, seed=3).demonstrations[0].actions()
    return dual[:, expert.layout.control_indices("joint")]


def make(perturbation, env_id="BimodalBypass-v2", **settings):
    return gym.make(env_id, perturbation=perturbation, **settings).unwrapped


def run(env, actions, seed=3):
    """Everything that the environment returns at a reset and in the steps of an episode."""
    returned = [env.reset(seed=seed)]
    for action in actions:
        returned.append(env.step(action))
        if returned[-1][2]:
            break
    return returned


def same(a, b):
    for first, second in zip(a, b, strict=True):
        for key in first[0]:
            np.testing.assert_array_equal(first[0][key], second[0][key])
        assert first[1:] == second[1:]


def test_every_kind_has_levels_that_get_harder_in_both_environments():
    assert set(EXAMPLES) == set(KINDS)
    for env_id in IDS:
        assert set(LEVELS[env_id]) == set(KINDS)
        for kind, levels in LEVELS[env_id].items():
            order = sorted(levels, reverse=kind == "friction")
            assert list(levels) == order
            for number, severity in enumerate(levels, start=1):
                assert parse_perturbation(f"{kind}@{number}", env_id).severity == severity
                assert parse_perturbation(f"{kind}:{severity}", env_id).severity == severity


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_checker_is_content(env_id, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=ADVICE)
        check_env(make(name, env_id), skip_render_check=True)


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_repeats_by_seed_in_a_pickled_copy_too(name, actions):
    env = make(name)
    first = run(env, actions[:100])
    run(env, actions[:5], seed=4)
    same(run(env, actions[:100]), first)
    same(run(pickle.loads(pickle.dumps(env)), actions[:100]), first)


@pytest.mark.parametrize("name", NAMES)
def test_a_state_restores_the_rest_of_a_perturbed_episode_bit_for_bit(name, actions):
    env, other = make(name), make(name)
    env.reset(seed=3)
    for action in actions[:80]:
        env.step(action)
    state = env.state()
    continued = [env.step(action) for action in actions[80:110]]
    other.reset(options={"state": state})
    same([other.step(action) for action in actions[80:110]], continued)


def test_an_episode_begins_like_the_unperturbed_one_of_its_seed():
    start = make(None)
    start.reset(seed=5)
    for name in NAMES:
        env = make(name)
        env.reset(seed=5)
        assert env.initial_state == start.initial_state
        np.testing.assert_array_equal(env.simulation.data.qpos, start.simulation.data.qpos)


def test_a_state_belongs_to_its_perturbation():
    nominal, noisy = make(None), make("noise:0.03")
    nominal.reset(seed=0)
    with pytest.raises(ValueError, match=r"recorded under perturbation=None, expected 'noise:0.03'") as error:
        noisy.reset(options={"state": nominal.state()})
    assert "\n" not in str(error.value)


def observed_difference(name, seed=3):
    """What a perturbation adds to the first observation."""
    nominal, perturbed = make(None).reset(seed=seed)[0], make(name).reset(seed=seed)[0]
    return {key: perturbed[key].astype(float) - nominal[key] for key in nominal}


def test_biases_of_sensors_have_the_size_that_was_asked_for_and_touch_nothing_else():
    cube = observed_difference("cube_bias:0.03")
    assert np.linalg.norm(cube["environment_state"][:2]) == pytest.approx(0.03, abs=1e-6)
    assert not cube["environment_state"][2:].any()
    assert not cube["agent_pos"].any()
    joint = observed_difference("joint_bias:0.06")
    assert np.linalg.norm(joint["agent_pos"][:7]) == pytest.approx(0.06, abs=1e-6)
    assert not joint["agent_pos"][7:].any()
    assert not joint["environment_state"].any()


def test_a_bias_stays_through_an_episode_and_changes_with_the_next():
    env = make("joint_bias:0.06")
    hold = np.append(make(None).reset(seed=0)[0]["agent_pos"][:7], 0.0)
    biases = []
    for seed in (0, 1):
        observation, _ = env.reset(seed=seed)
        offsets = [observation["agent_pos"][:7] - env.simulation.joints]
        offsets += [env.step(hold)[0]["agent_pos"][:7] - env.simulation.joints for _ in range(5)]
        np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], (6, 7)), atol=1e-6)
        biases.append(offsets[0])
    assert np.linalg.norm(biases[0] - biases[1]) > 1e-3


def test_noise_has_its_standard_deviation_and_is_white():
    env = make("noise:0.02")
    env.reset(seed=0)
    hold = np.append(env.simulation.joints, 0.0)
    joints, positions = [], []
    for _ in range(200):
        observation = env.step(hold)[0]
        joints.append(observation["agent_pos"][:7] - env.simulation.joints)
        positions.append(observation["agent_pos"][14:17] - env.simulation.position)
    assert np.std(joints) == pytest.approx(0.02, rel=0.1)
    assert np.std(positions) == pytest.approx(0.01, rel=0.1)
    joints = np.array(joints)
    assert abs(np.corrcoef(joints[1:].ravel(), joints[:-1].ravel())[0, 1]) < 0.1


def test_a_delayed_action_is_executed_later(actions):
    late, nominal = make("delay:3"), make(None)
    nominal.reset(seed=3)
    late.reset(seed=3)
    hold = late._hold()
    for action in [hold, hold, hold, *actions[:30]]:
        expected = nominal.step(action)[0]
    for action in actions[:33]:
        observed = late.step(action)[0]
    np.testing.assert_array_equal(observed["agent_pos"], expected["agent_pos"])


def test_a_slip_and_a_push_begin_after_the_lift_and_onset_says_when(actions):
    for name in ("slip:6", "push:150"):
        env, nominal = make(name), make(None)
        perturbed, plain = run(env, actions), run(nominal, actions)
        onset = next(info["onset"] for *_, info in perturbed if info["onset"] >= 0)
        assert 64 < onset < 160
        assert perturbed[0][1]["onset"] == -1
        assert all(info["onset"] in (-1, onset) for *_, info in perturbed)
        same(
            [(step[0], *step[1:4]) for step in perturbed[1 : onset + 1]],
            [(step[0], *step[1:4]) for step in plain[1 : onset + 1]],
        )
        after = min(onset + 2, len(perturbed) - 1)
        assert (perturbed[after][0]["agent_pos"] != plain[after][0]["agent_pos"]).any()


def test_scenes_are_changed_as_far_as_asked():
    nominal, heavy, smooth, moved, away = (
        make(name) for name in (None, "payload:4", "friction:0.3", "obstacle:0.06", "goal:0.06")
    )
    cube = nominal.simulation.model.body("cube_main").id
    assert heavy.simulation.model.body_mass[cube] == pytest.approx(4 * nominal.simulation.model.body_mass[cube])
    slides = smooth.simulation.model.geom_friction[:, 0] / nominal.simulation.model.geom_friction[:, 0]
    assert {round(value, 6) for value in slides} == {1.0, 0.3}
    moved.reset(seed=0)
    offset = moved.simulation.data.geom("obstacle_collision").xpos - moved.bypass.obstacle_center
    assert np.linalg.norm(offset) == pytest.approx(0.06)
    assert offset[2] == 0.0
    assert not observed_difference("obstacle:0.06")["environment_state"].any(), "the obstacle is moved unseen"
    observation, _ = away.reset(seed=0)
    assert np.linalg.norm(observation["environment_state"][9:12] - away.bypass.goal) == pytest.approx(0.06, abs=1e-6)
    np.testing.assert_allclose(away.simulation.goal, observation["environment_state"][9:12], atol=1e-6)


def failure(env, actions, seed=3):
    """How an episode of ``actions`` ends, when the last one is repeated until the time is up."""
    env.reset(seed=seed)
    for step in range(300):
        *_, terminated, _, info = env.step(actions[min(step, len(actions) - 1)])
        if terminated:
            break
    assert terminated or step == 299
    return info["failure"], info["is_success"]


def test_a_failure_is_named_by_what_became_of_the_cube(actions):
    assert failure(make(None), actions) == ("none", True)
    assert failure(make("goal:0.15"), actions) == ("miss", False), "let go where the goal is not"
    assert failure(make(None), actions[:40]) == ("miss", False), "never grasped"
    assert failure(make("slip:30"), actions) == ("drop", False), "lost on the way"
    assert failure(make(None), actions[:100]) == ("timeout", False), "still held"
    straight = actions[84].copy()
    straight[0] = 0.0
    towards = [straight + share * np.array([0, 0.9, 0, 0.9, 0, 0, 0, 0]) for share in np.linspace(0, 1, 40)]
    assert failure(make(None), [*actions[:84], *towards]) == ("collision", False)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("wind:3", "no known kind, expected one of cube_bias"),
        ("joint_bias", "severity '', which is no number"),
        ("joint_bias:much", "severity 'much', which is no number"),
        ("joint_bias:nan", "expected 0.0001 to 1"),
        ("joint_bias:-0.1", "expected 0.0001 to 1"),
        ("joint_bias:60", "expected 0.0001 to 1"),
        ("joint_bias@5", "level '5', expected 1 to 4"),
        ("joint_bias@0.06", "level '0.06', expected 1 to 4"),
        ("delay:1.5", "whole number of control steps"),
        (3, "is not text"),
    ],
)
def test_what_does_not_exist_is_refused_in_one_sentence(name, words):
    with pytest.raises(ValueError, match=words) as error:
        gym.make("BimodalBypass-v2", perturbation=name)
    assert "\n" not in str(error.value)
