"""Recorded rings: what is stored is what the environment measured, whatever interrupts the recording."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pyarrow.parquet as pq
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dualhead_envs.record import record
from dualhead_envs.ring.card import strongest_feature
from dualhead_envs.ring.record import record_ring

SMALL = {"episodes": 60, "conditions": 4}


def files_of(root):
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def columns_of(split):
    table = pq.read_table(split / "data")
    return {
        name: np.array(table[name].to_pylist(), dtype=np.float64 if "." in name else None)
        for name in table.column_names
    }


@pytest.fixture(scope="module", params=["orthogonal", "polar", "nullspace"])
def recorded(request, tmp_path_factory):
    kwargs = {"representation": request.param, "mode_probabilities": [0.7, 0.2, 0.1]}
    return record_ring("RotatingRing-v3", tmp_path_factory.mktemp("ring") / "data", env_kwargs=kwargs, **SMALL)


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_the_stored_actions_replay_the_stored_states(recorded, split):
    sidecar = json.loads((recorded / split / "meta/dualhead.json").read_text())
    for control, tolerance in (("position", 0.0), ("joint", 2e-6)):
        env = gym.make(f"dualhead_envs:{sidecar['env_id']}", **sidecar["env_kwargs"] | {"control": control})
        layout = env.unwrapped.layout
        assert sidecar["layout"] == layout.name
        assert sidecar["partition"] == env.unwrapped.mode_partition.to_dict()
        part = layout.action_slices[control]
        columns = columns_of(recorded / split)
        for episode in range(columns["episode_index"].max() + 1):
            rows = np.flatnonzero(columns["episode_index"] == episode)
            state = {"environment_state": columns["observation.environment_state"][rows[0]]}
            observation, _ = env.reset(options={"state": state})
            for row in rows:
                np.testing.assert_allclose(
                    observation["agent_pos"], columns["observation.state"][row], rtol=0, atol=tolerance
                )
                observation, _, _, _, info = env.step(columns["action"][row, part].astype(np.float32))
                np.testing.assert_allclose(
                    observation["agent_pos"], columns["action"][row, -2:], rtol=0, atol=tolerance
                )
            assert info["is_success"]
            assert info["mode"] == columns["mode"][rows[0]]


def test_both_representations_are_one_point(recorded):
    sidecar = json.loads((recorded / "train/meta/dualhead.json").read_text())
    ring = gym.make("RotatingRing-v3", **sidecar["env_kwargs"]).unwrapped
    action = columns_of(recorded / "train")["action"]
    groups = {name: action[:, part] for name, part in ring.layout.action_slices.items()}
    np.testing.assert_allclose(ring.ring.map.to_position(groups["joint"]), groups["position"], atol=1e-6)


def test_val_and_test_show_every_mode_of_every_condition(recorded):
    for split in ("val", "test"):
        columns = columns_of(recorded / split)
        first = columns["frame_index"] == 0
        shown = sorted(zip(columns["pair"][first], columns["mode"][first], strict=True))
        assert shown == [(pair, mode) for pair in range(4) for mode in range(3)]
        for pair in range(4):
            conditions = columns["observation.environment_state"][columns["pair"] == pair]
            assert (conditions == conditions[0]).all()


def test_train_draws_modes_from_the_prior_each_under_its_own_condition(recorded):
    columns = columns_of(recorded / "train")
    first = columns["frame_index"] == 0
    assert (columns["pair"][first] == np.arange(60)).all()
    counts = np.bincount(columns["mode"][first], minlength=3)
    assert counts[0] > counts[1] > counts[2] > 0


def test_lerobot_loads_it_and_its_windows_are_the_source(recorded):
    root = recorded / "train"
    windows = {"action": [h / 20 for h in range(16)]}
    dataset = LeRobotDataset("local/ring", root=root, delta_timestamps=windows, video_backend="pyav")
    assert (len(dataset), dataset.num_episodes, dataset.fps) == (60 * 16, 60, 20)
    columns = columns_of(root)
    for episode in (0, 31, 59):
        item = dataset[episode * 16]
        rows = slice(episode * 16, episode * 16 + 16)
        np.testing.assert_array_equal(item["action"].numpy(), np.float32(columns["action"][rows]))
        assert not item["action_is_pad"].any()
        assert item["mode"] == columns["mode"][episode * 16]
        assert item["task"] == "Go out to one of the 3 modes of the ring and come back."
    late = dataset[16 * 16 + 10]
    assert late["action_is_pad"].tolist() == [False] * 6 + [True] * 10


def test_the_data_do_not_depend_on_the_size_of_the_shards(tmp_path):
    sizes = {"episodes": 2100, "conditions": 5}  # more than two of the recorder's random blocks
    one = record_ring("RotatingRing-v2", tmp_path / "one", shard_size=700, seed=3, **sizes)
    other = record_ring("RotatingRing-v2", tmp_path / "other", shard_size=999, seed=3, **sizes)
    assert files_of(one) == files_of(other)


def test_seeds_share_their_bank_and_banks_differ(tmp_path):
    roots = [
        record_ring("RotatingRing-v2", tmp_path / str(i), seed=seed, bank_seed=bank, **SMALL | more)
        for i, (seed, bank, more) in enumerate([(0, 0, {}), (1, 0, {"conditions": 6}), (0, 1, {})])
    ]
    bank = [columns_of(root / "test")["action"] for root in roots]
    train = [columns_of(root / "train")["action"] for root in roots]
    np.testing.assert_array_equal(bank[1][: len(bank[0])], bank[0])
    assert (bank[2] != bank[0]).any()
    assert (train[1] != train[0]).any()
    np.testing.assert_array_equal(train[2], train[0])


SLOW = {"episodes": 1000, "shard_size": 20}  # many shards, so that there is time to interfere


def start_recording(root):
    code = f"import sys; from dualhead_envs.record import record; record(*sys.argv[1:], **{SLOW})"
    return subprocess.Popen([sys.executable, "-c", code, "RotatingRing-v2", str(root)])


def test_a_recording_killed_anywhere_resumes_to_the_same_bytes(tmp_path):
    whole = record("RotatingRing-v2", tmp_path / "whole", **SLOW)
    root = tmp_path / "killed"
    staging = tmp_path / ".killed.recording"
    for shards in (1, 15, 40, "assembly"):
        process = start_recording(root)
        while process.poll() is None:
            if shards == "assembly":
                reached = any((staging / "dataset").glob("*"))
            else:
                reached = len(list(staging.glob("*.npz"))) >= shards
            if reached:
                break
            time.sleep(0.001)
        assert process.poll() is None, "the recording ended before it could be killed"
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert not root.exists()
    assert len(list(staging.glob("*.npz"))) == 58  # nothing was lost
    assert start_recording(root).wait() == 0
    assert files_of(root) == files_of(whole)
    assert not staging.exists()


def test_a_second_recording_into_the_folder_is_refused(tmp_path):
    root = tmp_path / "data"
    process = start_recording(root)
    while not list((tmp_path / ".data.recording").glob("*.npz")):
        time.sleep(0.001)
    os.kill(process.pid, signal.SIGSTOP)
    try:
        with pytest.raises(BlockingIOError, match="another process"):
            record("RotatingRing-v2", root, **SLOW)
    finally:
        os.kill(process.pid, signal.SIGCONT)
    assert process.wait() == 0
    with pytest.raises(FileExistsError, match="already holds a dataset"):
        record("RotatingRing-v2", root, **SLOW)


def test_other_arguments_do_not_continue_an_unfinished_recording(tmp_path):
    process = start_recording(tmp_path / "data")
    while not list((tmp_path / ".data.recording").glob("*.npz")):
        time.sleep(0.001)
    process.kill()
    process.wait()
    with pytest.raises(FileExistsError, match="unfinished recording with another seeds"):
        record("RotatingRing-v2", tmp_path / "data", seed=1, **SLOW)


@pytest.mark.parametrize(
    ("env_id", "options", "message"),
    [
        ("RotatingRing-v5", {}, "'RotatingRing-v5' is unknown"),
        ("RotatingRing-v2", {"episodes": 0}, "episodes=0"),
        ("RotatingRing-v2", {"seed": -1}, "seed=-1"),
        ("RotatingRing-v2", {"env_kwargs": {"n_modes": 3}}, "n_modes, which the id decides"),
        ("RotatingRing-v2", {"env_kwargs": {"representation": "x"}}, "representation='x'"),
        ("RotatingRing-v2", {"env_kwargs": {"path_spread": 9.0}}, "out of the arena"),
    ],
)
def test_bad_arguments_leave_nothing_behind(tmp_path, env_id, options, message):
    with pytest.raises(ValueError, match=message):
        record(env_id, tmp_path / "data", **options)
    assert not list(tmp_path.iterdir())


def test_an_occupied_folder_is_left_alone_and_an_empty_one_used(tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="already holds other files"):
        record("RotatingRing-v2", tmp_path, **SMALL)
    with pytest.raises(FileExistsError, match="is a file"):
        record("RotatingRing-v2", tmp_path / "note.txt", **SMALL)
    (tmp_path / "empty").mkdir()
    record("RotatingRing-v2", tmp_path / "empty", **SMALL)
    assert (tmp_path / "empty/card.json").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "note.txt"]


def test_a_relative_folder_means_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert record("RotatingRing-v2", "a/b", **SMALL) == tmp_path / "a/b"


def test_the_card_measures_what_the_paper_reports(tmp_path):
    root = record("RotatingRing-v2", tmp_path / "data", episodes=20_000, conditions=500)
    card = json.loads((root / "card.json").read_text())
    assert card["measured"].keys() == card["meanings"].keys()
    assert card["measured"]["mode_gap_cv"] == pytest.approx(card["paper"]["mode_gap_cv"], abs=0.01)
    assert 0.5 < card["measured"]["single_feature_auroc"] < 0.53
    assert card["measured"]["valid_share_train"] > 1 - 1e-3


def test_a_shortcut_would_be_found():
    rng = np.random.default_rng(0)
    paths, modes = rng.normal(size=(400, 16, 2)), rng.integers(0, 2, 400)
    paths[:, 5, 1] += 10 * modes
    assert strongest_feature(paths, modes) == ("y at step 5", 1.0)
    assert strongest_feature(paths, np.zeros(400, dtype=int)) == ("", None)


def test_paths_that_belong_to_no_mode_are_kept_and_counted(tmp_path):
    root = record("RotatingRing-v2", tmp_path / "data", env_kwargs={"path_spread": 0.5}, **SMALL)
    card = json.loads((root / "card.json").read_text())
    assert card["measured"]["valid_share_train"] < 0.99
    assert columns_of(Path(root) / "train")["episode_index"].max() == 59
