"""Shards are whole or absent, and a staging folder belongs to one process and one configuration."""

import os

import numpy as np
import pytest

from dualhead_envs.recording.episode import Episode
from dualhead_envs.recording.shards import ShardStore


def episode(length=3, pair=0, **extra):
    rng = np.random.default_rng(pair)
    state, context, action = (rng.normal(size=(length, n)).astype(np.float32) for n in (2, 3, 4))
    return Episode(state, context, action, mode=pair % 2, pair=pair, branch_step=1, extra=extra)


def test_what_was_written_is_read(tmp_path):
    written = [episode(3, 0, clearance=0.5), episode(7, 1, clearance=0.25)]
    with ShardStore(tmp_path / "staging", {"seed": 0}) as store:
        store.write("train-0", written)
        store.write("empty", [])
        assert store.names() == ["empty", "train-0"]
        assert store.read("empty") == []
        for a, b in zip(store.read("train-0"), written, strict=True):
            np.testing.assert_array_equal(a.action, b.action)
            np.testing.assert_array_equal(a.observation_state, b.observation_state)
            np.testing.assert_array_equal(a.environment_state, b.environment_state)
            assert (a.mode, a.pair, a.branch_step, a.extra) == (b.mode, b.pair, b.branch_step, b.extra)


def test_half_written_shards_are_swept_away(tmp_path):
    with ShardStore(tmp_path, {}) as store:
        store.write("a", [episode()])
        (tmp_path / "b.partial").write_bytes(b"half")
    with ShardStore(tmp_path, {}) as store:
        assert store.names() == ["a"]
        assert not list(tmp_path.glob("*.partial"))


def test_shards_of_another_configuration_are_refused(tmp_path):
    with ShardStore(tmp_path, {"seed": 0, "env_id": "x"}) as store:
        store.write("a", [episode()])
    with pytest.raises(FileExistsError, match="unfinished recording with another seed"):
        ShardStore(tmp_path, {"seed": 1, "env_id": "x"}).__enter__()


def test_a_folder_without_shards_can_change_its_configuration(tmp_path):
    with ShardStore(tmp_path, {"seed": 0}):
        pass
    with ShardStore(tmp_path, {"seed": 1}) as store:
        store.write("a", [episode()])


def test_a_second_process_is_refused_until_the_first_ends(tmp_path):
    # A lock belongs to an open file, so two stores in one process stand for two processes.
    with ShardStore(tmp_path, {}), pytest.raises(BlockingIOError, match="another process"):
        ShardStore(tmp_path, {}).__enter__()
    with ShardStore(tmp_path, {}):
        pass


def test_a_damaged_shard_is_named(tmp_path):
    with ShardStore(tmp_path, {}) as store:
        store.write("a", [episode()])
        os.truncate(tmp_path / "a.npz", 100)
        with pytest.raises(ValueError, match=r"a\.npz is damaged"):
            store.read("a")


def test_discarding_leaves_nothing(tmp_path):
    with ShardStore(tmp_path / "staging", {}) as store:
        store.write("a", [episode()])
        store.discard()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("spoil", [np.nan, np.inf])
def test_an_episode_is_finite(spoil):
    with pytest.raises(ValueError, match="NaN or infinity in action"):
        Episode(np.zeros((2, 2)), np.zeros((2, 3)), np.full((2, 4), spoil), mode=0, pair=0, branch_step=0)


def test_an_episode_has_one_length():
    with pytest.raises(ValueError, match="one T > 0"):
        Episode(np.zeros((2, 2)), np.zeros((3, 3)), np.zeros((2, 4)), mode=0, pair=0, branch_step=0)
    with pytest.raises(ValueError, match="one T > 0"):
        Episode(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 4)), mode=0, pair=0, branch_step=0)
