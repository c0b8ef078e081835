"""What the README shows works: its Python runs, its commands parse."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from dualhead_eval.cli import COMMANDS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```(python|bash)\n(.*?)```", README, flags=re.DOTALL)
PYTHON = [code for language, code in BLOCKS if language == "python"]
LABELS = next(code for language, code in BLOCKS if language == "bash" and "--labels" in code)
SHELL = [line for language, code in BLOCKS if language == "bash" for line in code.splitlines() if line]


@pytest.mark.parametrize("code", PYTHON)
def test_a_python_example_prints_what_its_comments_say(code, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out.split("\n")
    expected = [line.split("# ")[1] for line in code.splitlines() if line.startswith("print(") and "# " in line]
    for line, comment in zip(printed, expected, strict=False):
        numbers = re.findall(r"-?\d+\.?\d*", comment)
        if numbers and not comment.startswith("the"):
            found = [float(number) for number in re.findall(r"-?\d+\.?\d*", line)]
            assert found == pytest.approx([float(number) for number in numbers], abs=1e-9)


@pytest.mark.parametrize("line", [line for line in SHELL if line.startswith("dualhead")])
def test_a_command_of_the_readme_parses(line):
    _, name, *arguments = shlex.split(line)
    module = importlib.import_module(COMMANDS[name][0])
    parser = argparse.ArgumentParser(allow_abbrev=False, exit_on_error=False)
    module.add_arguments(parser)
    args, remaining = parser.parse_known_args(arguments)
    if remaining:
        assert args.takes_remaining
        assert all(flag.startswith("--") and "=" in flag for flag in remaining)


def test_a_table_of_labels_comes_to_a_verdict_in_under_ten_lines(tmp_path):
    install, *rest = LABELS.splitlines()
    assert install == "pip install ."
    assert len(rest) < 9
    # This interpreter and its commands stand for what was installed.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    script = "set -e\n" + "\n".join(rest)
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert "coordinated in full" in done.stdout
    promised = re.search(r"The last command prints . = (\S+) %", README)
    assert promised
    assert f"{promised[1]}% [" in done.stdout


def test_every_linked_file_exists():
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if not link.startswith("http")]
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
