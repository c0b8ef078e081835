"""docs/your_own_task.md runs from top to bottom, and what it shows is so."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest

from dualhead_eval.certificate.reading import VERDICTS
from dualhead_eval.cli import main
from dualhead_eval.gate.file import read_gate
from dualhead_eval.statistics.run_summary import summarise_run

PAGE = (Path(__file__).parents[1] / "docs" / "your_own_task.md").read_text()
BLOCKS = re.findall(r"```(python|bash)\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_tutorial_comes_to_the_same_verdict_by_every_way(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "tutorial"}
    try:
        for language, code in BLOCKS:
            if language == "python":
                exec(compile(code, "your_own_task.md", "exec"), namespace)
                continue
            for line in code.splitlines():
                assert main(shlex.split(line)[1:]) == 0, capsys.readouterr().err
    finally:
        sys.modules.pop("pendulum_modes", None)
    printed = capsys.readouterr().out
    assert "(20, 16, 40, 2)" in printed
    assert "(20, 16) [0, 1]" in printed
    runs = {path.name.partition(".")[0]: read_gate(path) for path in tmp_path.glob("*.gate.json")}
    assert set(runs) == {"labels", "paths", "ends", "code"}
    # One task, four ways in: the same pairs have the same modes, up to their names.
    for gate in runs.values():
        assert gate.pair_table().sum() == 320
        assert summarise_run(gate).rho == pytest.approx(0.8, abs=0.1)
    assert (runs["paths"].pair_table() == runs["labels"].pair_table()).all()
    assert runs["paths"].strata["position"].unit == "mm"
    assert runs["paths"].heads == ("first", "second")
    assert printed.splitlines()[-1].split()[-1] in VERDICTS
    assert printed.splitlines()[-1].startswith("True")
