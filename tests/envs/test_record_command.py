"""``dualhead record`` from the outside."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DUALHEAD = Path(sys.executable).with_name("dualhead")


def dualhead_record(*arguments, cwd):
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        [DUALHEAD, "record", *map(str, arguments)], cwd=cwd, capture_output=True, text=True, env=environment
    )


def test_it_records_from_anywhere_and_says_what(tmp_path):
    done = dualhead_record("--root", "ring", "--episodes", 50, "--conditions", 3, "--no-progress", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "50 episodes" in done.stdout
    assert "mode_gap_cv" in done.stdout
    again = dualhead_record("--root", "ring", "--episodes", 50, cwd=tmp_path)
    assert again.returncode == 2
    assert again.stderr.startswith("dualhead: error: ")
    assert "already holds a dataset" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env", "RotatingRing-v5"], "'RotatingRing-v5' is unknown"),
        (["--pairs", 3], "--pairs is not an option of RotatingRing-v2"),
        (
            ["--env", "v2", "--representation", "polar"],
            "--representation is not an option of BimodalBypass-v2",
        ),
        (["--preset", "full", "--episodes", 3], "give one of them"),
        (["--mode-probabilities", 0.5, 0.6], "sum to 1"),
        (["--episodes", 0], "episodes=0"),
    ],
)
def test_mistakes_are_one_sentence_and_leave_nothing(tmp_path, arguments, message):
    failed = dualhead_record("--root", "data", *arguments, cwd=tmp_path)
    assert failed.returncode == 2
    assert message in failed.stderr
    assert failed.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
