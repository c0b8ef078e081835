"""A table of labels becomes a gate, or one sentence about what is wrong with it."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualhead_eval.cli import main
from dualhead_eval.evaluation.label_table import label_gate, read_label_table
from dualhead_eval.gate.file import read_gate
from dualhead_eval.statistics.run_summary import summarise_run, summarise_table

GOOD = {"condition": [0, 0, 1, 1], "label_a": [0, 1, 0, -1], "label_b": [0, 1, 1, 0]}


def written(path: Path, table: object, **options: object) -> Path:
    frame = pd.DataFrame(table)
    if path.suffix == ".csv":
        frame.to_csv(path, index=False, **options)  # type: ignore[call-overload]
    else:
        frame.to_parquet(path, index=False)
    return path


@pytest.mark.parametrize("name", ["labels.csv", "labels.parquet"])
def test_every_row_is_counted_in_its_condition(tmp_path, name):
    gate = label_gate(read_label_table(written(tmp_path / name, GOOD)), label="mine")
    assert gate.pair_table().tolist() == [
        [[1, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[0, 1, 0], [0, 0, 0], [1, 0, 0]],
    ]
    assert (gate.n_modes, gate.heads, gate.label) == (2, ("a", "b"), "mine")
    assert gate.provenance["table"]["n_modes"] == "inferred"
    assert gate.provenance["table"]["rows"] == 4


@settings(deadline=None, max_examples=15)
@given(data=st.data(), k=st.integers(2, 5), rows=st.integers(1, 60))
def test_counts_are_those_of_the_rows_in_any_order_and_conditions_may_differ_in_size(data, k, rows, tmp_path_factory):
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    table = {
        "condition": rng.integers(0, 6, rows),
        "label_a": rng.integers(-1, k, rows),
        "label_b": rng.integers(-1, k, rows),
    }
    path = tmp_path_factory.mktemp("labels") / "t.parquet"
    gate = label_gate(read_label_table(written(path, table)), k, label="x")
    order = rng.permutation(rows)
    again = label_gate(read_label_table(written(path, {n: c[order] for n, c in table.items()})), k, label="x")
    assert (gate.counts == again.counts).all()
    assert gate.counts.sum() == rows
    for index, condition in enumerate(np.unique(table["condition"])):
        here = table["condition"] == condition
        for a in range(-1, k):
            for b in range(-1, k):
                expected = (here & (table["label_a"] == a) & (table["label_b"] == b)).sum()
                assert gate.pair_table()[index, a, b] == expected


def test_the_verdict_is_that_of_the_counts(tmp_path):
    rng = np.random.default_rng(0)
    a = rng.integers(0, 3, (20, 80))
    b = np.where(rng.random(a.shape) < 0.7, a, rng.integers(0, 3, a.shape))
    table = {"condition": np.repeat(np.arange(20), 80), "label_a": a.ravel(), "label_b": b.ravel()}
    gate = label_gate(read_label_table(written(tmp_path / "t.csv", table)), label="x")
    by_hand = summarise_table(gate.pair_table())
    assert summarise_run(gate).rho == pytest.approx(by_hand.rho)
    assert by_hand.rho == pytest.approx(0.7, abs=0.06)


def test_conditions_of_an_episode_are_numbered_within_it_and_resampled_together(tmp_path):
    table = {**GOOD, "condition": [0, 0, 0, 1], "episode": ["first", "first", "second", "second"]}
    gate = label_gate(read_label_table(written(tmp_path / "t.parquet", table)), label="x")
    assert gate.pair_ids.tolist() == [0, 1, 1]
    assert gate.pair_table().sum(axis=(1, 2)).tolist() == [2, 1, 1]


def test_the_modes_are_given_or_as_labelled(tmp_path):
    table = read_label_table(written(tmp_path / "t.csv", GOOD))
    assert label_gate(table, 4, label="x").n_modes == 4
    alone = read_label_table(written(tmp_path / "u.csv", {**GOOD, "label_a": [-1] * 4, "label_b": [0] * 4}))
    assert label_gate(alone, label="x").n_modes == 2


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"label_b": None}, "lacks 'label_b'"),
        ({"labels": [0, 1, 0, 1]}, "has a column 'labels'"),
        ({"label_a": [0, 1.5, 0, 1]}, "label_a = 1.5 in row 2"),
        ({"label_a": [0, 1, np.nan, 1]}, "row 3"),
        ({"label_a": [0, 1, np.inf, 1]}, "row 3"),
        ({"label_a": ["left", "right", "left", "left"]}, "expected whole numbers from -1"),
        ({"label_a": [0, 1, 0, -2]}, "label_a = -2 in row 4"),
        ({"label_a": [0, 1, 0, 5]}, "label 5 (row 4 is the first beyond 2)"),
        ({"label_a": [0, 1, 0, 10**12]}, "row 4"),
        ({"condition": [0.5, 0, 1, 1]}, "expected whole numbers or names"),
        ({"sample": [0, 0, 0, 1]}, "the sample of row 1 more than once"),
        ({name: [] for name in GOOD}, "holds no rows"),
    ],
)
def test_what_is_wrong_with_a_table_is_one_sentence(suffix, change, sentence, tmp_path, capsys):
    table = {name: column for name, column in {**GOOD, **change}.items() if column is not None}
    path = written(tmp_path / f"labels{suffix}", table)
    output = tmp_path / "mine.gate.json"
    assert main(["evaluate", "--labels", str(path), "--modes", "3", "--output", str(output)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("labels.csv", b"", "not a readable csv"),
        ("labels.csv", b"condition,label_a,label_b\n0,0\n", "not a readable csv"),
        ("labels.csv", b"condition,label_a,label_a,label_b\n0,0,0,0\n", "'label_a' twice"),
        ("labels.csv", b"condition,label_a,label_b\n0,,1\n", "no label_a in row 1"),
        ("labels.parquet", b"PAR1 not really", "not a readable parquet"),
        ("labels.txt", b"0 0 0", "neither .csv nor .parquet"),
    ],
)
def test_a_file_that_is_no_table_is_one_sentence(name, content, sentence, tmp_path, capsys):
    (tmp_path / name).write_bytes(content)
    assert main(["evaluate", "--labels", str(tmp_path / name), "--output", str(tmp_path / "g.json")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_a_missing_file_and_options_of_other_uses_are_refused(tmp_path, capsys):
    path = written(tmp_path / "t.csv", GOOD)
    for arguments, sentence in [
        (["--labels", "nowhere.csv"], "does not exist"),
        (["--labels", str(path), "--tau", "0.1"], "--tau has no meaning with --labels"),
        (["--labels", str(path), "--modes", "1"], "expected 2 to 1000"),
        (["--labels", str(path), "--dataset", "d"], "--dataset has no meaning with --labels"),
    ]:
        assert main(["evaluate", *arguments, "--output", str(tmp_path / "g.json")]) == 2
        assert sentence in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_damaged_table_never_does_anything_but_read_or_refuse(suffix, tmp_path):
    """A byte changed, a piece cut out: a table or a ValueError, nothing else."""
    rng, complaints = random.Random(0), []
    good = written(tmp_path / f"good{suffix}", {**GOOD, "episode": [0, 0, 1, 1]}).read_bytes()
    path = tmp_path / f"bad{suffix}"
    for _ in range(150):
        data = bytearray(good)
        start = rng.randrange(len(data))
        if rng.random() < 0.5:
            data[start] = rng.randrange(256)
        else:
            del data[start : start + rng.randrange(1, 20)]
        path.write_bytes(bytes(data))
        try:
            gate = label_gate(read_label_table(path), label="x")
            assert gate.counts.sum() >= 1
        except ValueError as error:
            complaints.append(str(error))
    assert len(complaints) > 10
    assert all(str(path) in complaint for complaint in complaints)


def test_the_command_writes_a_gate_that_reports_without_threshold_or_steps(tmp_path, capsys):
    path, output = written(tmp_path / "t.csv", GOOD), tmp_path / "mine.gate.json"
    assert main(["evaluate", "--labels", str(path), "--output", str(output)]) == 0
    printed = capsys.readouterr().out
    assert "K = 2, heads = a / b" in printed
    assert "τ = 0" not in printed
    assert read_gate(output).label == "mine"
    assert main(["report", str(output)]) == 0
