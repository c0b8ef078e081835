"""Notebooks of tutorials: ``python docs/make_notebooks.py`` writes them anew from their pages, without outputs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
#: Tutorials that are notebooks, too.
PAGES = ("environment", "certificate")


def notebook_of(page: str) -> dict[str, Any]:
    """A notebook (format 4.5) with a page's text and code in its order."""
    text = (DOCS / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
    cells: list[dict[str, Any]] = []
    # Text and code alternate; links lead on from the notebook's folder.
    for number, part in enumerate(re.split(r"^```python\n(.*?)^```\n?", text, flags=re.DOTALL | re.MULTILINE)):
        if not (source := part.strip("\n")):
            continue
        code = {"execution_count": None, "outputs": []} if number % 2 else {}
        if not number % 2:
            source = re.sub(r"\]\((?!\.\./|https?:)([^)]+\.md)\)", r"](../tutorials/\1)", source)
        cells.append(
            {
                "cell_type": "code" if number % 2 else "markdown",
                "id": f"{page}-{len(cells)}",
                "metadata": {},
                "source": source.splitlines(keepends=True),
                **code,
            }
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def text_of(page: str) -> str:
    """The notebook's file."""
    return json.dumps(notebook_of(page), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    for page in PAGES:
        (DOCS / "notebooks" / f"{page}.ipynb").write_text(text_of(page), encoding="utf-8")


if __name__ == "__main__":
    main()
