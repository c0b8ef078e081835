"""A recorded dataset is read whole and consistent, or refused in one sentence that says where it contradicts itself."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dualhead_envs.dataset_columns import data_files
from dualhead_envs.dataset_frames import read_split
from dualhead_envs.recording.geometry_card import read_geometry_card


@pytest.fixture
def split(ring_data, tmp_path):
    return shutil.copytree(ring_data / "test", tmp_path / "test")


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def rewrite(split, change):
    """Rewrite the data file with its columns, NumPy arrays by name, changed."""
    (path,) = data_files(split)
    table = pq.read_table(path)
    columns = {name: table.column(name) for name in table.column_names}
    change(columns)
    pq.write_table(pa.table(columns), path)


def numbers(column):
    return column.to_numpy().copy()


def set_value(name, frame, value):
    def change(columns):
        values = numbers(columns[name])
        values[frame] = value
        columns[name] = values

    return change


def drop_last_rows(columns):
    for name in columns:
        columns[name] = columns[name].slice(0, len(columns[name]) - 3)


def repeat_a_row(columns):
    rows = np.r_[0, 0, 2 : len(columns["index"])]
    for name in columns:
        columns[name] = columns[name].take(pa.array(rows))


DATA = {
    "rows that are missing": (drop_last_rows, "frames, expected the"),
    "a row given twice": (repeat_a_row, "each once"),
    "an episode out of order": (set_value("episode_index", 5, 3), "one after the other"),
    "a frame out of order": (set_value("frame_index", 5, 9), "one after the other"),
    "a mode that does not exist": (set_value("mode", 0, 7), "holds mode from 0 to 7, expected from -1 to below 2"),
    "a negative pair": (set_value("pair", 0, -1), "holds pair from -1"),
    "a branch beyond the episode": (set_value("branch_step", 0, 99), "below the length of the episode"),
    "a column of another type": (
        lambda columns: columns.update(mode=numbers(columns["mode"]).astype(float)),
        "holds double in 'mode', expected int64",
    ),
    "a column of words": (lambda columns: columns.update(mode=[str(m) for m in numbers(columns["mode"])]), "string"),
    "empty values": (lambda columns: columns.update(mode=[None] * len(columns["mode"])), "'mode', expected"),
    "no such column": (lambda columns: columns.pop("mode"), "lacks the column 'mode'"),
    "rows of another width": (
        lambda columns: columns.update(action=[[1.0, 2.0]] * len(columns["action"])),
        "holds (double|rows of another width)",
    ),
    "numbers that are none": (
        lambda columns: columns.update(action=pa.array([[np.nan] * 8] * len(columns["mode"]), pa.list_(pa.float32()))),
        "non-finite value in 'action' at frame 0",
    ),
}  # fmt: skip
INFO = {
    "another version": (lambda info: info.update(codebase_version="v2.1"), "= 'v2.1', expected 'v3.0'"),
    "another number of frames": (lambda info: info.update(total_frames=9), "expected the 9"),
    "another number of episodes": (lambda info: info.update(total_episodes=9), "does not hold 9 episodes"),
    "a width beyond reason": (lambda info: info["features"]["action"].update(shape=[10**9]), r"action\.shape"),
    "another width": (lambda info: info["features"]["action"].update(shape=[5]), "names the dimensions"),
    "names that are no list": (lambda info: info["features"]["action"].update(names=None), "names the dimensions"),
    "features that are no object": (lambda info: info.update(features=[1]), "features"),
    "no rate": (lambda info: info.update(fps=0), "fps"),
}  # fmt: skip
SIDECAR = {
    "another format": (lambda card: card.update(format="dualhead-dataset/9"), "dualhead-dataset/1"),
    "an environment of another package": (lambda card: card.update(env_id="os:system"), "names no environment"),
    "an unknown field": (lambda card: card.update(colour="red"), "unknown field 'colour'"),
    "probabilities of other modes": (lambda card: card.update(mode_probabilities=[1.0]), "expected 2 that sum to 1"),
    "a partition of one mode": (lambda card: card["partition"].update(n_modes=1), r"partition\.n_modes = 1"),
    "a negative threshold": (lambda card: card["partition"].update(tau=-1), r"partition\.tau = -1"),
    "a layout of control codes": (lambda card: card.update(layout="\x1b[2J"), "printable text"),
}


def test_a_whole_split_is_read(split):
    assert len(read_split(split).conditions()) == 12


@pytest.mark.parametrize("what", DATA)
def test_data_are_refused_with(split, what):
    change, sentence = DATA[what]
    rewrite(split, change)
    with pytest.raises(ValueError, match=sentence) as refusal:
        read_split(split)
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize(("file", "cases"), [("info.json", INFO), ("dualhead.json", SIDECAR)])
def test_a_description_is_refused_with_whatever_contradicts_the_data(ring_data, tmp_path, file, cases):
    for number, (what, (change, sentence)) in enumerate(cases.items()):
        copy = shutil.copytree(ring_data / "test", tmp_path / str(number))
        edit(copy / "meta" / file, change)
        with pytest.raises(ValueError, match=sentence) as refusal:
            read_split(copy)
        assert str(refusal.value).isprintable(), what


def test_a_flipped_bit_of_the_data_does_not_pass(split):
    (path,) = data_files(split)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for where in rng.integers(4, len(whole) // 2, size=12):  # the pages; the footer lies behind them
        path.write_bytes(whole[:where] + bytes([whole[where] ^ 0x10]) + whole[where + 1 :])
        try:
            same = np.array_equal(read_split(split).action, read_split_of(whole, path, split).action)
        except ValueError:
            continue
        assert same


def read_split_of(whole, path, split):
    path.write_bytes(whole)
    return read_split(split)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda card: card.pop("measured"), "lacks the field 'measured'"),
        (lambda card: card.update(measured={}), "measured"),
        (lambda card: card["measured"].update(rejections="[red]none"), r"measured\.rejections"),
        (lambda card: card.update(meanings={"\x1b[2J": "x"}), "printable text"),
        (lambda card: card.update(format=2), "dualhead-card/1"),
    ],
)
def test_a_geometry_card_is_refused(ring_data, tmp_path, change, sentence):
    path = shutil.copy(ring_data / "card.json", tmp_path / "card.json")
    assert read_geometry_card(path).measured["rejections"] == 0
    edit(path, change)
    with pytest.raises(ValueError, match=sentence):
        read_geometry_card(path)
