"""Closed-loop outcomes: counted from rollouts, read back, shown with Wilson's interval."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from dualhead_eval.cli import main
from dualhead_eval.evaluation.rollouts import ClosedLoop, read_closed_loop


def sidecar(successes, failures, *, control="joint", **more):
    outcomes = [
        {"seed": i, "success": i < successes, "collision": False, "mode": 0} for i in range(successes + failures)
    ]
    return {
        "format": "dualhead-rollouts/1",
        "env_id": "BimodalBypass-v2",
        "env_kwargs": {"control": control},
        "outcomes": outcomes,
        **more,
    }


@pytest.mark.parametrize(("successes", "episodes"), [(0, 10), (7, 10), (150, 150), (131, 150)])
def test_the_interval_is_wilsons(successes, episodes):
    interval = ClosedLoop("BimodalBypass-v2", "joint", episodes, successes, 0).success_interval
    # The roots of (share - p)^2 = z^2 p (1 - p) / n.
    z2, share = 1.959963984540054**2, successes / episodes
    roots = np.roots([1 + z2 / episodes, -2 * share - z2 / episodes, share**2])
    assert (interval.low, interval.high) == pytest.approx(sorted(roots.real), abs=1e-6)


def test_a_copy_of_the_outcomes_is_reported_like_the_rollouts(tmp_path, capsys):
    (tmp_path / "rollouts" / "meta").mkdir(parents=True)
    text = json.dumps(sidecar(9, 1, control="position", policy={"training_step": 50_000}))
    (tmp_path / "rollouts" / "meta" / "dualhead.json").write_text(text)
    (tmp_path / "oracle.rollouts.json").write_text(text)
    assert read_closed_loop(tmp_path / "rollouts")[1] == read_closed_loop(tmp_path / "oracle.rollouts.json")[1]
    assert main(["report", str(tmp_path / "rollouts"), str(tmp_path / "oracle.rollouts.json")]) == 0
    shown = capsys.readouterr().out
    assert shown.count("90.0% [59.6,98.2]") == 2
    assert "oracle, 50000 steps" in shown


def test_two_processes_do_not_record_into_one_folder(trained, ring_data, tmp_path, capsys):
    target = tmp_path / "rollouts"
    left_by_a_kill = tmp_path / ".rollouts.partial"
    left_by_a_kill.mkdir()
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--record", str(target)]
    arguments += ["--episodes", "1", "--output", str(tmp_path / "loop.gate.json")]
    hold = "import filelock, sys\nlock = filelock.FileLock(sys.argv[1])\nlock.acquire()\nprint(flush=True)\ninput()"
    command = [sys.executable, "-c", hold, str(tmp_path / ".rollouts.lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        assert main(arguments) == 2
        other.stdin.write(b"\n")
    assert "another process records rollouts" in capsys.readouterr().err
    assert main(arguments) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"rollouts", "loop.gate.json"}


def test_what_is_no_outcome_is_refused(tmp_path, capsys):
    assert main(["report", str(tmp_path / "gone.rollouts.json")]) == 2
    assert "does not exist" in capsys.readouterr().err
    for name, text in {"cut": '{"format": ', "foreign": '{"format": "x/1"}', "list": "[]"}.items():
        path = tmp_path / f"{name}.rollouts.json"
        path.write_text(text)
        assert main(["report", str(path)]) == 2
        error = capsys.readouterr().err.strip()
        assert error.count("\n") == 0
        assert "again" in error or "--record" in error


def test_a_rolled_out_policy_keeps_what_became_of_its_episodes(trained, ring_data, tmp_path, capsys):
    target = tmp_path / "rollouts"
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--record", str(target)]
    assert main([*arguments, "--episodes", "3", "--output", str(tmp_path / "loop.gate.json")]) == 0
    assert "joint head driving: success" in capsys.readouterr().out
    kept = json.loads((target / "meta" / "dualhead.json").read_text())
    assert [outcome["seed"] for outcome in kept["outcomes"]] == [0, 1, 2]
    assert kept["policy"]["training_step"] == 30
    name, loop = read_closed_loop(target)
    assert (name, loop.episodes) == ("rollouts, 30 steps", 3)
    assert loop.successes == sum(outcome["success"] for outcome in kept["outcomes"])
