"""A hook of MkDocs: links of a page to the repository's other files, which a site does not hold, become plain text."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((\.\./[^)#\s]+)\)")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Keep the words of a link that leaves the documentation, and say which file it names.

    Raises:
        FileNotFoundError: If there is no such file: a link is never lost unnoticed.
    """
    folder = (ROOT / "docs" / page.file.src_uri).parent

    def plain(link: re.Match[str]) -> str:
        target = (folder / link[2]).resolve()
        if target.is_relative_to(ROOT / "docs"):
            return link[0]
        if not target.exists():
            raise FileNotFoundError(f"{page.file.src_uri} links to {link[2]}, which is not there")
        name = target.relative_to(ROOT).as_posix()
        return link[1] if name.rstrip("/") in link[1] else f"{link[1]} (`{name}` in the repository)"

    return _LINK.sub(plain, markdown)
