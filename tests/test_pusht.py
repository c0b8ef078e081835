"""docs/pusht.md runs from top to bottom: another environment and LeRobot's policies come to a verdict."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from dualhead_eval.cli import main
from dualhead_eval.gate.file import read_gate
from dualhead_eval.statistics.run_summary import summarise_run

PAGE = (Path(__file__).parents[1] / "docs" / "pusht.md").read_text()
BLOCKS = re.findall(r"```(python|bash)\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_pusht_comes_to_a_verdict(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "tutorial"}
    for language, code in BLOCKS:
        if language == "python":
            exec(compile(code, "pusht.md", "exec"), namespace)
            continue
        for line in code.splitlines():
            command, *arguments = shlex.split(line)
            if command == "dualhead":
                assert main(arguments) == 0, capsys.readouterr().err
                continue
            program = Path(sys.executable).with_name(command)
            done = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr[-2000:]
    gates = {path.name.partition(".")[0]: read_gate(path) for path in tmp_path.glob("gates/*.gate.json")}
    assert set(gates) == {"act", "diffusion"}
    act, diffusion = summarise_run(gates["act"]), summarise_run(gates["diffusion"])
    assert gates["act"].provenance["deterministic"] is True
    assert not act.capacity > 0
    assert gates["act"].target_probabilities.tolist() == [0.5, 0.5]
    # A diffusion policy keeps both sides; trained this briefly, it cuts the corner in some draws.
    assert diffusion.valid_rate > 0.25
    assert diffusion.capacity_relative > 0.5
    assert abs(diffusion.rho) < 0.2
    assert gates["diffusion"].strata == {}  # pixels are no metres
