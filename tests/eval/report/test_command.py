"""``dualhead report`` prints what it is given and writes what it is asked for, and overwrites nothing."""

import json
import subprocess
import sys

import pytest

from dualhead_eval.gate import write_gate


def test_the_command_writes_what_was_asked_and_overwrites_nothing(make_gate, report_command, tmp_path, capsys):
    gate = write_gate(make_gate("run one", 0.6), tmp_path / "gate.json")
    numbers, figure = tmp_path / "report.json", tmp_path / "region.png"
    assert report_command(gate, "--json", numbers, "--figure", figure) == 0
    assert "run one" in capsys.readouterr().out
    assert json.loads(numbers.read_text())[0]["label"] == "run one"
    before = numbers.read_bytes(), figure.read_bytes()
    with pytest.raises(FileExistsError, match="--overwrite"):
        report_command(gate, "--json", numbers)
    assert (numbers.read_bytes(), figure.read_bytes()) == before
    assert report_command(gate, "--json", numbers, "--overwrite") == 0


def test_a_dataset_folder_prints_its_card(ring_data, report_command, tmp_path, capsys):
    assert report_command(ring_data) == 0
    out = capsys.readouterr().out
    for word in ("mode_gap_cv", "0.1767", "single_feature_auroc", "distance between the two nearest modes"):
        assert word in out
    with pytest.raises(FileNotFoundError, match=r"no card\.json"):
        report_command(tmp_path)
    (tmp_path / "card.json").write_text('{"a": 1}')
    with pytest.raises(ValueError, match="lacks the field"):
        report_command(tmp_path)
    (tmp_path / "card.json").write_text('{"a": ')
    with pytest.raises(ValueError, match="truncated or not JSON"):
        report_command(tmp_path)


def test_a_damaged_file_is_refused_in_one_line(tmp_path):
    bad = tmp_path / "bad.json"
    bad.write_text("{")
    done = subprocess.run(
        [sys.executable, "-m", "dualhead_eval", "report", str(bad)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "truncated" in done.stderr


def test_a_folder_of_gates_is_reported_beside_the_paper(make_gate, report_command, tmp_path, capsys):
    for seed, label in enumerate(("b", "a")):
        gate = make_gate(label, partition="bypass-v2", seed=seed, config={"seed": seed})
        write_gate(gate, tmp_path / f"{label}.gate.json")
    assert report_command(tmp_path) == 0
    out = capsys.readouterr().out
    assert "v2/A independent" in out
    assert out.index(" a ") < out.index(" b ")
    assert report_command(tmp_path, "--no-paper") == 0
    assert "the paper's row" not in capsys.readouterr().out
    assert report_command(tmp_path, "--every-quantity") == 0
    assert "capacity" in capsys.readouterr().out
    assert report_command(tmp_path, "--tau", "0.4") == 0
    assert "at the reference point alone" in " ".join(capsys.readouterr().out.split())
