"""BimodalBypass-v2 with a third way, over the wall: episodes, demonstrations, recording."""

import json
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from lerobot.envs.factory import make_env, make_env_config

import dualhead_envs.lerobot_envs  # noqa: F401  (registers the choices)
from dualhead_envs.bypass.card import MEANINGS
from dualhead_envs.bypass.demonstrations import demonstrate_modes
from dualhead_envs.bypass.preview import write_preview
from dualhead_envs.bypass.record import record_bypass, split_sizes
from dualhead_envs.dataset_frames import read_split
from dualhead_envs.recording.geometry_card import read_geometry_card

ENV_ID = "BimodalBypass-v2"
SETS = 4


def make(**settings):
    return gym.make(f"dualhead_envs:{ENV_ID}", **settings).unwrapped


@pytest.fixture(scope="module")
def ways():
    return demonstrate_modes(make(control="pose", ways=3), seed=3)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "three"
    return record_bypass(ENV_ID, root, pairs=SETS, seed=5, env_kwargs={"ways": 3}, workers=1, progress=False)


def test_all_three_succeed_from_one_state_without_touching_the_wall(ways):
    assert len(ways.demonstrations) == 3
    assert ways.success
    assert all(demonstration.clearance > 0.020 for demonstration in ways.demonstrations)
    ends = np.array([demonstration.positions()[-1] for demonstration in ways.demonstrations])
    assert np.ptp(ends, axis=0).max() < 1e-3


def test_they_are_one_up_to_the_branch_and_apart_after_it(ways):
    paths = [demonstration.positions() for demonstration in ways.demonstrations]
    for path in paths[1:]:
        np.testing.assert_allclose(path[: ways.branch_step + 1], paths[0][: ways.branch_step + 1], atol=1e-5)
        assert np.linalg.norm(path[ways.branch_step + 16] - paths[0][ways.branch_step + 16]) > 0.15


@pytest.mark.parametrize("control", ["joint", "position", "pose"])
def test_each_ways_own_states_lead_to_the_goal_under_every_control(ways, control):
    env = make(control=control, ways=3)
    indices = env.layout.control_indices(control)
    for mode, demonstration in enumerate(ways.demonstrations):
        env.reset(options={"state": {"environment_state": demonstration.environment_state[0]}})
        for action in demonstration.actions():
            _, _, terminated, _, info = env.step(action[indices])
            if terminated:
                break
        assert info == {"is_success": True, "mode": mode, "collision": False, "failure": "none", "onset": -1}


def test_with_two_ways_the_way_over_is_of_no_mode(ways):
    over = ways.demonstrations[2]
    window = over.positions()[ways.branch_step + 1 : ways.branch_step + 17]
    assert make(ways=3).mode_partition.assign(window, over.environment_state[0]) == 2
    assert make().mode_partition.assign(window, over.environment_state[0]) == -1


def test_a_third_way_changes_no_episode_of_the_other_two(ways):
    two = demonstrate_modes(make(control="pose"), seed=3)
    assert two.branch_step == ways.branch_step
    assert two.amplitude == ways.amplitude
    for a, b in zip(two.demonstrations, ways.demonstrations[:2], strict=True):
        np.testing.assert_array_equal(a.actions(), b.actions())
        np.testing.assert_array_equal(a.agent_pos, b.agent_pos)


def test_gymnasiums_checker_is_content():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(symmetric and normalized space|value is -?infinity).*")
        check_env(make(ways=3), skip_render_check=True)


def test_a_pickled_copy_has_as_many_ways():
    env = make(ways=3)
    copy = pickle.loads(pickle.dumps(env))
    assert copy.mode_partition.to_dict() == env.mode_partition.to_dict()
    assert copy.task_description == env.task_description != make().task_description


def test_a_state_on_its_way_over_does_not_fit_an_environment_of_two_ways(ways):
    env = make(ways=3)
    over = ways.demonstrations[2]
    indices = env.layout.control_indices("joint")
    env.reset(options={"state": {"environment_state": over.environment_state[0]}})
    for action in over.actions()[: ways.branch_step + 20]:
        _, _, _, _, info = env.step(action[indices])
    assert info["mode"] == 2
    state = env.state()
    assert make(ways=3).reset(options={"state": state})[1]["mode"] == 2
    with pytest.raises(ValueError, match="as many ways"):
        make().reset(options={"state": state})


@pytest.mark.parametrize("number", [0, 1, 4, "three", None])
def test_other_numbers_of_ways_are_refused(number):
    with pytest.raises(ValueError, match="should be 2"):
        make(ways=number)
    with pytest.raises(ValueError, match="ways"):
        make_env_config("bimodal_bypass", ways=number)


def test_lerobot_makes_it_with_three_ways():
    env = make_env(make_env_config("bimodal_bypass", ways=3), n_envs=1)["bimodal_bypass"][0]
    assert env.envs[0].unwrapped.mode_partition.n_modes == 3
    env.close()


def test_a_set_is_one_demonstration_a_mode_and_belongs_to_one_split(recording):
    seen = set()
    for split, size in split_sizes(SETS).items():
        frames = read_split(recording / split)
        pairs = np.unique(frames.labels["pair"])
        assert len(pairs) == size == len(frames.conditions())
        assert not seen & set(pairs)
        seen |= set(pairs)
        assert frames.info["total_episodes"] == 3 * size
        windows = frames.mode_windows(16)
        assert windows.shape == (size, 3, 16, 3)
        env = make(**frames.sidecar["env_kwargs"])
        assert env.mode_partition.to_dict() == frames.sidecar["partition"]
        assert frames.sidecar["mode_probabilities"] == [1 / 3] * 3
        for mode in range(3):
            assert (env.mode_partition.assign(windows[:, mode], np.zeros(18)) == mode).all()


def test_the_card_measures_the_two_nearest_ways_and_names_no_line_between_two(recording):
    card = read_geometry_card(recording / "card.json")
    measured = card.measured
    windows = np.concatenate([read_split(recording / split).mode_windows(16) for split in split_sizes(SETS)])
    gaps = [np.linalg.norm(windows[:, i] - windows[:, j], axis=-1).mean(axis=1) for i, j in ((0, 1), (0, 2), (1, 2))]
    assert measured["mode_gap_mean_mm"] == pytest.approx(1e3 * np.min(gaps, axis=0).mean(), rel=1e-6)
    assert measured["frames"] == sum(read_split(recording / split).info["total_frames"] for split in split_sizes(SETS))
    assert measured["valid_share_test"] == measured["single_feature_auroc"] == 1.0
    assert set(MEANINGS) - set(measured) == {
        "nonlateral_gap_mean_mm", "separation_angle_min_deg", "separation_angle_max_deg", "separation_angle_sd_deg",
        "lateral_share_min", "lateral_share_mean",
    }  # fmt: skip
    assert not card.paper, "the paper has no third way"
    assert set(card.meanings) == set(measured)


def test_an_interrupted_recording_of_two_ways_is_not_finished_with_three(tmp_path, monkeypatch):
    from dualhead_envs.recording.shards import ShardStore

    write = ShardStore.write

    def write_once(store, name, episodes):
        write(store, name, episodes)
        raise KeyboardInterrupt

    monkeypatch.setattr(ShardStore, "write", write_once)
    with pytest.raises(KeyboardInterrupt):
        record_bypass(ENV_ID, tmp_path / "v2", pairs=3, workers=1, progress=False)
    monkeypatch.undo()
    with pytest.raises(FileExistsError, match="another env_kwargs"):
        record_bypass(ENV_ID, tmp_path / "v2", pairs=3, env_kwargs={"ways": 3}, workers=1, progress=False)


def test_only_the_wall_has_ways_to_choose(tmp_path):
    with pytest.raises(TypeError, match="ways"):
        record_bypass("RotatingBypass-v3", tmp_path / "v3", pairs=3, env_kwargs={"ways": 3}, progress=False)


def test_the_preview_shows_three_rows(tmp_path):
    from PIL import Image

    from dualhead_envs.bypass.rendering import _is_installed

    said = write_preview(ENV_ID, tmp_path / "ways.png", seed=1, ways=3)
    with Image.open(tmp_path / "ways.png") as picture:
        width, height = picture.size
    if _is_installed("egl") or _is_installed("osmesa"):
        assert "shows" in said
        assert height == 3 * 200
        assert width == 8 * 200
    else:
        assert "plots the measured path of every mode" in said


def test_the_description_is_json(recording):
    content = json.loads((recording / "train" / "meta" / "dualhead.json").read_text())
    assert content["env_kwargs"] == {"ways": 3}
    assert content["partition"]["name"] == "bypass-v2-three-ways"
