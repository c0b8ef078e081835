"""BimodalBypass-v2 without its wall: how far apart the two sides lie is then the demonstrations' to choose."""

import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from lerobot.envs.factory import make_env, make_env_config

import dualhead_envs.lerobot_envs  # noqa: F401  (registers the choices)
from dualhead_envs.bypass.demonstrations import apex_miss, demonstrate_modes
from dualhead_envs.bypass.record import record_bypass, split_sizes
from dualhead_envs.dataset_frames import read_split
from dualhead_envs.recording.geometry_card import read_geometry_card

ENV_ID = "BimodalBypass-v2"
PAIRS = 3
#: The lift pose, from which the sides part; everything before it is shared.
LIFT = 84


def make(**settings):
    return gym.make(f"dualhead_envs:{ENV_ID}", **settings).unwrapped


def open_env(amplitude=None, **settings):
    return make(obstacle="none", amplitude=amplitude, **settings)


@pytest.fixture(scope="module", params=[0.0, 0.02])
def recording(request, tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "open"
    settings = {"obstacle": "none", "amplitude": request.param}
    return record_bypass(ENV_ID, root, pairs=PAIRS, env_kwargs=settings, workers=1, progress=False), request.param


@pytest.mark.parametrize("amplitude", [0.0, 0.005, 0.08, 0.2])
def test_both_sides_reach_the_goal_by_a_step_as_wide_as_asked_for(amplitude):
    pair = demonstrate_modes(open_env(amplitude, control="pose"), seed=3)
    assert pair.success
    left, right = (demonstration.positions()[:, 1] for demonstration in pair.demonstrations)
    beside = slice(LIFT + 24, LIFT + 38)  # the side step is over, the way back has not begun
    assert left[beside].mean() == pytest.approx(amplitude, abs=0.004)
    np.testing.assert_allclose(right[beside], -left[beside], atol=0.004)


def test_sides_of_no_step_are_one_way_and_branch_where_they_were_meant_to():
    pair = demonstrate_modes(open_env(0.0, control="pose"), seed=3)
    first, second = pair.demonstrations
    np.testing.assert_array_equal(first.actions(), second.actions())
    assert pair.branch_step == LIFT


def test_an_amplitude_changes_no_start_and_nothing_before_the_branch():
    own, wide, narrow = (
        demonstrate_modes(env, seed=3)
        for env in (make(control="pose"), open_env(0.165, control="pose"), open_env(0.02, control="pose"))
    )
    assert wide.amplitude / 0.165 == pytest.approx(narrow.amplitude / 0.02) == pytest.approx(own.amplitude / 0.1695)
    for pair in (wide, narrow):
        for mine, theirs in zip(pair.demonstrations, own.demonstrations, strict=True):
            np.testing.assert_array_equal(mine.positions()[: LIFT + 1], theirs.positions()[: LIFT + 1])


def test_the_straight_way_goes_through_where_the_wall_would_stand():
    straight = demonstrate_modes(open_env(0.0, control="pose"), seed=3).demonstrations[0]
    for env, collides in ((open_env(control="joint"), False), (make(control="joint"), True)):
        env.reset(seed=3)
        for action in straight.actions()[:, env.layout.control_indices("joint")]:
            _, _, terminated, _, info = env.step(action)
            if terminated:
                break
        assert (info["collision"], info["is_success"]) == (collides, not collides)


def test_observations_report_a_box_without_extent_where_the_wall_stood():
    with_wall, without = (env.reset(seed=3)[0]["environment_state"] for env in (make(), open_env()))
    np.testing.assert_array_equal(without[:15], with_wall[:15])
    assert not without[15:].any()
    assert with_wall[15:].all()


def test_the_wall_that_is_asked_for_by_name_is_the_default():
    observations = [make(obstacle="wall").reset(seed=1)[0], make().reset(seed=1)[0]]
    for key, values in observations[0].items():
        np.testing.assert_array_equal(values, observations[1][key])
    assert make(obstacle="wall").task_description == make().task_description != open_env().task_description


def test_gymnasiums_checker_is_content():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(symmetric and normalized space|value is -?infinity).*")
        check_env(open_env(0.02), skip_render_check=True)


def test_a_pickled_copy_has_no_wall_either():
    copy = pickle.loads(pickle.dumps(open_env(0.02)))
    assert not copy.bypass.has_obstacle
    assert copy.demonstrated_amplitude == 0.02
    assert pickle.loads(pickle.dumps(make())).bypass.has_obstacle


def test_states_belong_to_scenes_with_or_without_a_wall():
    env, walled = open_env(), make()
    first, _ = env.reset(seed=3)
    walled.reset(seed=3)
    env.reset(options={"state": env.state()})
    for state, other in ((env.state(), walled), (walled.state(), env)):
        with pytest.raises(ValueError, match="made with the same obstacle"):
            other.reset(options={"state": state})
    with pytest.raises(ValueError, match="another scene"):
        walled.reset(options={"state": {"environment_state": first["environment_state"]}})


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"obstacle": "beam"}, "'wall' or 'none'"),
        ({"amplitude": 0.1}, "obstacle='none'"),
        ({"obstacle": "none", "amplitude": -0.1}, "0 to 0.2"),
        ({"obstacle": "none", "amplitude": 0.3}, "0 to 0.2"),
        ({"obstacle": "none", "amplitude": float("nan")}, "0 to 0.2"),
        ({"obstacle": "none", "amplitude": "wide"}, "0 to 0.2"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(settings, words):
    for maker in (make, lambda **given: make_env_config("bimodal_bypass", **given)):
        with pytest.raises(ValueError, match=words) as error:
            maker(**settings)
        assert "\n" not in str(error.value)


def test_a_wall_that_is_not_there_cannot_be_moved():
    with pytest.raises(ValueError, match="not there"):
        make(obstacle="none", perturbation="obstacle:0.05")


def test_lerobot_makes_it_without_a_wall():
    env = make_env(make_env_config("bimodal_bypass", obstacle="none", amplitude=0.02), n_envs=1)["bimodal_bypass"][0]
    assert not env.envs[0].unwrapped.bypass.has_obstacle
    env.close()


def test_a_recording_says_how_it_was_made_and_keeps_the_sides_apart(recording):
    root, amplitude = recording
    for split in split_sizes(PAIRS):
        frames = read_split(root / split)
        assert frames.sidecar["env_kwargs"] == {"obstacle": "none", "amplitude": amplitude}
        assert make(**frames.sidecar["env_kwargs"]).demonstrated_amplitude == amplitude
        assert set(frames.labels["mode"]) == {0, 1}
        left, right = frames.mode_windows(16)[0]
        assert (left[-1, 1] - right[-1, 1] > 0.9 * 2 * amplitude) == (amplitude > 0)


def test_a_card_leaves_out_what_is_not_defined_and_names_no_paper(recording):
    root, amplitude = recording
    card = read_geometry_card(root / "card.json")
    assert not card.paper
    assert card.measured["clearance_min_mm"] is None
    assert (card.measured["mode_gap_cv"] is None) == (card.measured["lateral_share_mean"] is None) == (amplitude == 0)
    assert card.measured["valid_share_test"] == 0.0, "the partition's tau is the wall's"


def test_a_miss_of_an_apex_in_the_middle_is_the_largest_distance_from_it():
    path = np.array([[0.03, 0.955], [0.01, 0.955], [-0.001, 0.955]])
    assert apex_miss(path, np.array([0.0, 0.955])) == pytest.approx((0.03, 0.03))
