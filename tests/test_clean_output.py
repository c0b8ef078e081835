"""Every command keeps standard error clean: progress bars, and nothing else, on a machine with or without FFmpeg."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

#: A line of tqdm, or of the terminal control that rich writes with its bars.
PROGRESS = re.compile(r"^\s*$|\d+%\||\d+/\d+ ?\[|━")
#: Runs the commands of argv[1] one after the other, as a terminal would, but imports every library once.
COMMANDS = """
import json, sys
from dualhead_eval.cli import main
if __name__ == "__main__":
    for command in json.loads(sys.argv[1]):
        print(f"<{command[0]}>", file=sys.stderr, flush=True)
        if status := main(command):
            sys.exit(status)
"""


def test_the_pipeline_says_nothing_on_standard_error_but_its_progress(tmp_path):
    small = ["--policy.velocity_width=32", "--policy.encoder_dim=16", "--policy.device=cpu"]
    train = ["train", "--dataset.root=ring/train", *small]
    evaluate = ["evaluate", "--dataset", "ring/test"]
    commands = [
        ["record", "--env", "RotatingRing-v3", "--root", "ring", "--episodes", "40", "--conditions", "4"],
        [*train, "--output_dir=run", "--steps=4"],
        [*train, "--output_dir=runs", "--steps=2", "--seeds", "0", "1"],
        [*evaluate, "--policy", "run", "--pairs", "16", "--output", "run.json"],
        [*evaluate, "--exact", "--pairs", "16", "--output", "exact.json"],
        [*evaluate, "--policy", "run", "--record", "loops", "--episodes", "2", "--output", "loops.json"],
        ["report", "run.json", "exact.json", "--figure", "region.png", "--json", "numbers.json"],
        ["report", "ring"],
    ]
    script = tmp_path / "commands.py"
    script.write_text(COMMANDS)
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    done = subprocess.run(
        [sys.executable, str(script), json.dumps(commands)],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    begun = [f"<{command[0]}>" for command in commands]
    said = [line for line in re.split(r"[\r\n]", done.stderr) if not PROGRESS.search(line)]
    assert said == begun, "something besides progress was written to standard error"
    assert "exact" in done.stdout
