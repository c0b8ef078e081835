"""A Markdown template: hand-written text, and lines that ask for a table.

<!-- insert NAME ARGUMENT ... -->
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping

#: What an insert is given: its arguments; it returns Markdown.
Insert = Callable[[list[str]], str]
_LINE = re.compile(r"<!-- insert (?P<request>.*\S) -->")


def filled(text: str, inserts: Mapping[str, Insert], *, source: str) -> str:
    """The template with every insert in its place.

    Args:
        text: The template.
        inserts: Inserts by name.
        source: The template's name, for errors.

    Raises:
        ValueError: If a line asks for an insert that does not exist, or one is refused; says which line.
    """
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        asked = _LINE.fullmatch(line)
        if asked is None:
            lines.append(line)
            continue
        name, *arguments = shlex.split(asked["request"])
        if name not in inserts:
            raise ValueError(f"{source}, line {number}, asks for {name!r}, expected one of {', '.join(inserts)}")
        try:
            lines.append(inserts[name](arguments))
        except (FileNotFoundError, ValueError) as error:
            raise ValueError(f"{source}, line {number}: {error}") from error
    return "\n".join(lines) + "\n"


def markdown_table(columns: list[str], rows: list[list[str]]) -> str:
    """A Markdown table; a bar in a cell is escaped.

    >>> print(markdown_table(["run", "x"], [["a|b", "1"]]))
    | run | x |
    | --- | --- |
    | a\\|b | 1 |
    """
    lines = [columns, ["---"] * len(columns), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def percent(value: float | None, *, digits: int = 1) -> str:
    """A share in signed percent, as the page prints rho."""
    if value is None or value != value:
        return "-"
    return f"{100 * value:+.{digits}f} %"
