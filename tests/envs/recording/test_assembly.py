"""The bulk writer against LeRobot's own incremental writer, on the same frames."""

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dualhead_envs.recording import assembly
from dualhead_envs.recording.assembly import assemble
from dualhead_envs.recording.episode import Episode
from dualhead_envs.ring.layout import ring_layout

LAYOUT = ring_layout("nullspace")
TASK = "Go out and come back."
FILES = ("data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet", "meta/tasks.parquet")


def episodes(lengths):
    rng = np.random.default_rng(0)
    return [
        Episode(
            *(rng.normal(size=(length, n)).astype(np.float32) for n in (2, 3, 8)),
            mode=i % 2,
            pair=i // 2,
            branch_step=i,
        )
        for i, length in enumerate(lengths)
    ]


@pytest.fixture(scope="module")
def by_lerobot(tmp_path_factory):
    root = tmp_path_factory.mktemp("lerobot") / "data"
    dataset = LeRobotDataset.create(
        "local/ring", fps=LAYOUT.fps, features=LAYOUT.dataset_features(), root=root, use_videos=False
    )
    for episode in episodes((16, 1, 9, 16)):
        for t in range(len(episode)):
            frame = {
                "observation.state": episode.observation_state[t],
                "observation.environment_state": episode.environment_state[t],
                "action": episode.action[t],
                "task": TASK,
            }
            for key in ("mode", "pair", "branch_step"):
                frame[key] = np.array([getattr(episode, key)])
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture(scope="module")
def by_us(tmp_path_factory):
    recorded = episodes((16, 1, 9, 16))
    target = tmp_path_factory.mktemp("ours") / "data"
    return assemble([recorded[:1], recorded[1:]], target, LAYOUT, {"split": "train"}, task=TASK)


@pytest.mark.parametrize("name", FILES)
def test_every_column_is_the_one_that_lerobot_writes(by_lerobot, by_us, name):
    theirs, ours = pq.read_schema(by_lerobot / name), pq.read_schema(by_us / name)
    assert ours.names == theirs.names
    for a, b in zip(ours, theirs, strict=True):
        assert a.type == b.type
    theirs, ours = pd.read_parquet(by_lerobot / name), pd.read_parquet(by_us / name)
    pd.testing.assert_index_equal(ours.index, theirs.index)
    for column in theirs.columns:
        for a, b in zip(ours[column], theirs[column], strict=True):
            if column.startswith("stats/"):
                np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9, err_msg=column)
            else:
                np.testing.assert_array_equal(a, b, err_msg=column)


def test_info_is_the_one_that_lerobot_writes(by_lerobot, by_us):
    assert json.loads((by_us / "meta/info.json").read_text()) == json.loads((by_lerobot / "meta/info.json").read_text())


def test_statistics_are_the_ones_that_lerobot_computes(by_lerobot, by_us):
    theirs = json.loads((by_lerobot / "meta/stats.json").read_text())
    ours = json.loads((by_us / "meta/stats.json").read_text())
    assert ours.keys() == theirs.keys()
    for key, statistics in theirs.items():
        assert ours[key].keys() == statistics.keys()
        for name, values in statistics.items():
            np.testing.assert_allclose(ours[key][name], values, rtol=1e-5, atol=1e-6, err_msg=f"{key} {name}")


def test_nothing_is_overwritten(by_us):
    with pytest.raises(FileExistsError, match="already exists"):
        assemble([episodes((3,))], by_us, LAYOUT, {}, task=TASK)


def test_what_does_not_fit_the_layout_is_refused(tmp_path):
    with pytest.raises(ValueError, match="action of width 8, layout ring/polar expects 4"):
        assemble([episodes((3,))], tmp_path / "data", ring_layout("polar"), {}, task=TASK)
    with pytest.raises(ValueError, match="no episode"):
        assemble([[]], tmp_path / "data", LAYOUT, {}, task=TASK)
    assert not list(tmp_path.iterdir())


def test_large_datasets_are_split_where_an_episode_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(assembly, "_FILE_BYTES", 4000)
    monkeypatch.setattr(assembly, "_FILES_A_CHUNK", 2)
    recorded = episodes((16, 5, 9, 16, 1, 12, 16, 16))
    root = assemble([recorded], tmp_path / "data", LAYOUT, {}, task=TASK)
    assert len(list(root.glob("data/*/*.parquet"))) > 2
    assert len(list(root.glob("data/*"))) > 1
    dataset = LeRobotDataset("local/ring", root=root, video_backend="pyav")
    np.testing.assert_array_equal(
        np.array(dataset.hf_dataset.with_format("numpy")["action"]),
        np.concatenate([episode.action for episode in recorded]),
    )
    for i, episode in enumerate(recorded):
        path = root / dataset.meta.get_data_file_path(i)
        rows = pq.read_table(path, filters=[("episode_index", "=", i)])
        assert len(rows) == len(episode)
