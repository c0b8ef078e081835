"""Every command keeps standard error clean: progress bars, and nothing else, on a machine with or without FFmpeg."""

from __future__ import annotations

import os
import re
import subprocess
import sys

#: A line of tqdm, or of the terminal control that rich writes with its bars.
PROGRESS = re.compile(r"^\s*$|\d+%\||\d+/\d+ ?\[|━")


def dualhead(folder, *arguments):
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    done = subprocess.run(
        [sys.executable, "-m", "dualhead_eval.cli", *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    chatter = [line for line in re.split(r"[\r\n]", done.stderr) if not PROGRESS.search(line)]
    assert chatter == [], f"dualhead {arguments[0]} wrote to standard error: {chatter[:5]}"
    return done.stdout


def test_the_whole_line_says_nothing_on_standard_error_but_its_progress(tmp_path):
    small = ["--policy.velocity_width=32", "--policy.encoder_dim=16", "--policy.device=cpu"]
    dualhead(tmp_path, "record", "--env", "RotatingRing-v3", "--root", "ring", "--episodes", "40", "--conditions", "4")
    dualhead(tmp_path, "train", "--dataset.root=ring/train", "--output_dir=run", "--steps=4", *small)
    dualhead(
        tmp_path, "train", "--dataset.root=ring/train", "--output_dir=runs", "--steps=2", "--seeds", "0", "1", *small
    )
    evaluate = ["evaluate", "--dataset", "ring/test", "--pairs", "16"]
    dualhead(tmp_path, *evaluate, "--policy", "run", "--output", "run.json")
    dualhead(tmp_path, *evaluate, "--exact", "--output", "exact.json")
    dualhead(tmp_path, *evaluate, "--policy", "run", "--record", "loops", "--episodes", "2", "--output", "loops.json")
    out = dualhead(tmp_path, "report", "run.json", "exact.json", "--figure", "region.png", "--json", "numbers.json")
    assert "exact" in out
    dualhead(tmp_path, "report", "ring")
