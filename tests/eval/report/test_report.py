"""The report says what the counts say, in words that need no paper."""

import argparse
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from dualhead_eval.commands.report import add_arguments, run
from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.gate.gate import Gate, write_gate
from dualhead_eval.report.content import render_table, report_json, report_rows
from dualhead_eval.report.figures.region import draw_region
from dualhead_eval.statistics.bootstrap import Interval
from dualhead_eval.statistics.run_summary import summarise_run


def make_gate(label, couple, k=2, invalid=0.0, partition="ring", heads=2, prior=None):
    rng = np.random.default_rng(0)
    shared = rng.choice(k, p=prior, size=(12, 400))
    labels = []
    for _ in range(heads):
        own = np.where(rng.random(shared.shape) < couple, shared, rng.choice(k, p=prior, size=shared.shape))
        labels.append(np.where(rng.random(shared.shape) < invalid, -1, own))
    return Gate(
        heads=("joint", "position", "rotation")[:heads],
        n_modes=k,
        taus=[0.55],
        nfes=[20],
        reference_tau=0.55,
        reference_nfe=20,
        counts=joint_counts(labels[0], labels[1], k, *labels[2:])[None, None],
        conditions=np.zeros((12, 3)),
        pair_ids=np.arange(12),
        provenance={"label": label, "partition": {"name": partition, "n_modes": k, "tau": 0.55}},
    )


def printed(renderable, width=140):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(renderable)
    return console.export_text()


def test_each_occupancy_is_named():
    rows = report_rows(
        [
            make_gate("independent", 0.0),
            make_gate("half", 0.7),
            make_gate("token", 1.0),
            make_gate("one mode", 1.0, prior=[1.0, 0.0]),
        ]
    )
    assert rows[0].reading.startswith("uncoordinated within ±")
    assert [row.reading for row in rows[1:]] == [
        "partly coordinated (III)",
        "coordinated (IV)",
        "collapsed: a head chose one mode in every condition",
    ]


def test_under_trained_ring_runs_are_flagged_and_robots_are_not():
    ring, robot = report_rows(
        [make_gate("ring", 0.5, invalid=0.1), make_gate("robot", 0.5, invalid=0.1, partition="bypass-v2")]
    )
    assert ring.reading == "not yet readable: valid-pair rate below 0.95"
    assert robot.readable


def test_the_table_prints_every_number_with_its_operating_point():
    gate = make_gate("my run", 1.0)
    text = printed(render_table([gate]))
    summary = summarise_run(gate)
    for cell in (
        "my run",
        "0.55",
        "20",
        f"{summary.capacity:.4f}",
        f"{summary.delta:+.4f}",
        "+100.0% [+100.0,+100.0]",
    ):
        assert cell in text
    assert "nan" not in text


def test_the_table_fits_a_narrow_terminal():
    text = printed(render_table([make_gate("shared noise (nullspace)", 0.3), make_gate("token", 1.0, k=4)]), width=80)
    for whole in ("partly", "coordinated", "+100.0%", "[+100.0,+100.0]", "K", "±100.0%"):
        assert any(whole in line for line in text.splitlines())


def test_a_wide_interval_around_zero_is_unclear_rather_than_a_class():
    (row,) = report_rows([make_gate("independent", 0.0)])
    wide = Interval(-0.08, 0.02, 0.95)
    summary = replace(row.summary, rho=-0.03, occupancy=Occupancy.NEGATIVE, intervals={"rho": wide})
    assert replace(row, summary=summary).reading.startswith("unclear")


def test_undefined_numbers_are_words_in_the_table_and_null_in_json():
    gate = make_gate("one mode", 1.0, prior=[1.0, 0.0])
    assert "undefined" in printed(render_table([gate]))
    (entry,) = json.loads(json.dumps(report_json(report_rows([gate])), allow_nan=False))
    assert entry["rho"] is None
    assert entry["intervals"]["rho"]["low"] is None
    assert "single mode" in entry["reason"]


def test_three_heads_make_three_rows():
    rows = report_rows([make_gate("pose", 0.5, heads=3)])
    assert [row.summary.heads for row in rows] == [
        ("joint", "position"),
        ("joint", "rotation"),
        ("position", "rotation"),
    ]
    assert "joint / rotation" in printed(render_table(rows))


def test_the_region_is_drawn_as_png(tmp_path):
    path = draw_region([make_gate("a", 0.2), make_gate("b", 0.9, k=4)], tmp_path / "deep" / "region.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    empty = make_gate("none", 0.0, invalid=1.0)
    with pytest.raises(ValueError, match="no run has a both-valid pair"):
        draw_region([empty], tmp_path / "empty.png")


def parse(*arguments):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args([str(argument) for argument in arguments])


def test_the_command_writes_what_was_asked_and_overwrites_nothing(tmp_path, capsys):
    gate = write_gate(make_gate("run one", 0.6), tmp_path / "gate.json")
    numbers, figure = tmp_path / "report.json", tmp_path / "region.png"
    assert run(parse(gate, "--json", numbers, "--figure", figure)) == 0
    assert "run one" in capsys.readouterr().out
    assert json.loads(numbers.read_text())[0]["label"] == "run one"
    before = numbers.read_bytes(), figure.read_bytes()
    with pytest.raises(FileExistsError, match="--overwrite"):
        run(parse(gate, "--json", numbers))
    assert (numbers.read_bytes(), figure.read_bytes()) == before
    assert run(parse(gate, "--json", numbers, "--overwrite")) == 0


def test_a_dataset_folder_prints_its_card(ring_data, tmp_path, capsys):
    assert run(parse(ring_data)) == 0
    out = capsys.readouterr().out
    for word in ("mode_gap_cv", "0.1767", "single_feature_auroc", "distance between the two nearest modes"):
        assert word in out
    with pytest.raises(FileNotFoundError, match=r"no card\.json"):
        run(parse(tmp_path))
    (tmp_path / "card.json").write_text('{"a": 1}')
    with pytest.raises(ValueError, match="'measured'"):
        run(parse(tmp_path))
    (tmp_path / "card.json").write_text('{"a": ')
    with pytest.raises(ValueError, match="not complete JSON"):
        run(parse(tmp_path))


def test_the_module_refuses_bad_input_in_one_line(tmp_path):
    bad = tmp_path / "bad.json"
    bad.write_text("{")
    done = subprocess.run(
        [sys.executable, "-c", "import sys; from dualhead_eval.commands.report import *\nimport argparse\n"
         "p = argparse.ArgumentParser(); add_arguments(p)\n"
         "try: run(p.parse_args())\n"
         "except ValueError as e: sys.exit(str(e))", str(bad)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "truncated" in done.stderr


def test_the_core_imports_neither_torch_nor_matplotlib():
    code = (
        "import sys, dualhead_eval.effects.contingency, dualhead_eval.gate.gate, dualhead_eval.statistics.run_summary, "
        "dualhead_eval.commands.report\n"
        "sys.exit(str([m for m in ('torch', 'lerobot', 'matplotlib', 'gymnasium', 'rich') if m in "
        "sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "[]"
