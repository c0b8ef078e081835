"""Every tutorial runs from top to bottom in an empty folder, and prints what its comments say."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from dualhead_eval.cli import main

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"
#: Pages whose trainings take minutes.
SLOW = {"your_own_policy", "monitor", "reproduce"}
PAGES = [
    pytest.param(page, marks=pytest.mark.slow if page.stem in SLOW else (), id=page.stem)
    for page in sorted(FOLDER.glob("*.md"))
    if page.stem != "index"
]


def blocks_of(page):
    """Language and code of every block that a reader runs, with the line on which it begins."""
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```(python|bash)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    return [(block[1], block[2], text[: block.start(2)].count("\n")) for block in found]


def promises(code):
    """What the comments behind a block's top-level prints promise; those in words promise nothing."""
    lines = [line for line in code.splitlines() if line.startswith("print(") and "  # " in line]
    said = [(line, re.split(r"[:;] ", line.rsplit("  # ", 1)[1])[0]) for line in lines]
    return [
        (line, words) for line, words in said if re.fullmatch(r"[\w().,\s-]+", words) and not words.startswith("cos")
    ]


@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_runs_and_prints_what_it_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "tutorial"}
    for language, code, line in blocks_of(page):
        if language == "python":
            # Line numbers of an error are those of the page.
            exec(compile("\n" * line + code, str(page), "exec"), namespace)
            printed = " ".join(re.sub(r"torch\.Size\(\[([^]]*)\]\)", r"(\1)", capsys.readouterr().out).split())
            for statement, words in promises(code):
                for word in words.split():
                    assert word.strip(",") in printed, (statement, printed)
            continue
        for command in code.splitlines():
            program, *arguments = shlex.split(command)
            assert program == "dualhead"
            assert main(arguments) == 0, capsys.readouterr().err


def test_the_tutorials_are_all_in_the_navigation():
    navigation = (FOLDER.parents[1] / "mkdocs.yml").read_text(encoding="utf-8")
    index = (FOLDER / "index.md").read_text(encoding="utf-8")
    for page in FOLDER.glob("*.md"):
        assert f"tutorials/{page.name}" in navigation
        assert page.stem == "index" or f"]({page.name})" in index
