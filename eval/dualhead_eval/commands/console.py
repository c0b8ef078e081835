"""The console of a command's tables, and the files that it must not replace unasked."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

#: A pipe or a file has no width of its own; the tables need about this much.
PIPE_WIDTH = 140


def open_console() -> Console:
    """Standard output, as wide as the terminal or as the tables need. What is printed is text, never markup."""
    from rich.console import Console

    console = Console(markup=False, highlight=False, emoji=False)
    return console if console.is_terminal else Console(width=PIPE_WIDTH, markup=False, highlight=False, emoji=False)


def refuse_overwrite(outputs: Iterable[Path | None], *, overwrite: bool) -> None:
    """Refuse to replace files that exist.

    Raises:
        FileExistsError: If an output exists and ``overwrite`` is false.
    """
    for output in outputs:
        if output is not None and output.exists() and not overwrite:
            raise FileExistsError(f"{output} exists: choose another name or add --overwrite")
