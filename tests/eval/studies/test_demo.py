"""The demo: the whole pipeline at a tiny budget, continued where it stopped, never over something else."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from dualhead_eval.cli import main
from dualhead_eval.evaluation.labelled_pairs import HEADS
from dualhead_eval.gate import Gate, read_gate
from dualhead_eval.studies import demo
from dualhead_eval.studies.demo_table import story_table
from dualhead_eval.studies.plan import Budget
from dualhead_eval.studies.stages import Demo

TINY = Budget(demonstrations=64, steps=4, save_freq=2, pairs=8)
PLAN = replace(demo.RING_PLAN, policies=demo.RING_PLAN.policies[:1], rows=demo.RING_PLAN.rows[:2])


@pytest.fixture
def tiny_demo(monkeypatch):
    monkeypatch.setitem(demo.PLANS, "ring", replace(PLAN, budgets={"smoke": TINY}))


def test_the_demo_records_trains_evaluates_and_tells_the_story(tiny_demo, tmp_path, capsys):
    root = tmp_path / "demo"
    assert main(["demo", "--env", "ring", "--output", str(root)]) == 0
    out = capsys.readouterr().out
    assert "independent noise" in out
    assert "-0." in out or "+0." in out
    assert (root / "region.png").stat().st_size > 10_000
    gate = read_gate(root / "gates" / "shared-noise-nullspace.reference.gate.json")
    assert gate.counts.sum() == 75 * TINY.pairs
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*.safetensors")}
    assert main(["demo", "--env", "ring", "--output", str(root)]) == 0
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*.safetensors")} == before


def test_a_row_with_too_few_valid_pairs_is_flagged_instead_of_telling_its_story():
    def gate(invalid):
        counts = np.array([[40, 40, 0], [40, 40, 0], [0, 0, invalid]])
        partition = {"partition": {"name": "ring"}, "label": "row", "method": "policy"}
        return Gate(HEADS, 2, [0.55], [20], 0.55, 20, counts[None, None, None], np.zeros((1, 3)), np.zeros(1), None,
                    partition)  # fmt: skip

    def printed(invalid):
        console = Console(width=140, record=True, file=io.StringIO())
        console.print(story_table([(PLAN.rows[0], gate(invalid), None)]))
        return console.export_text()

    assert "The floor" in printed(0)
    assert "The floor" not in printed(40)
    assert "Not yet readable: only 80% of pairs" in printed(40)


def test_a_folder_that_holds_something_else_is_refused(tiny_demo, tmp_path, capsys):
    (tmp_path / "precious.txt").write_text("mine")
    assert main(["demo", "--env", "ring", "--output", str(tmp_path)]) == 2
    assert "is not empty and holds no demo" in capsys.readouterr().err
    run = Demo(PLAN, TINY, tmp_path / "a", seed=0, jobs=1)
    run.claim_folder()
    with pytest.raises(FileExistsError, match="other settings"):
        Demo(PLAN, TINY, tmp_path / "a", seed=1, jobs=1).claim_folder()
