"""A hook of MkDocs for the repository's other files: links to them become plain text, pictures come along."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
#: Folder of the site for pictures from outside the documentation.
PICTURES = "pictures"
_PICTURE = re.compile(r"(!\[[^\]]*\]\()(\.\./[^)\s]+)\)")
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((\.\./[^)#\s]+)\)")


def on_files(files: Any, *, config: Any, **_: Any) -> Any:
    """Take the pictures that pages show from elsewhere in the repository into the site."""
    shown = {
        name
        for page in files.documentation_pages()
        for _, link in _PICTURE.findall(page.content_string)
        if (name := _outside(page.src_uri, link)) is not None
    }
    for name in sorted(shown):
        files.append(File.generated(config, f"{PICTURES}/{name}", abs_src_path=str(ROOT / name)))
    return files


def _outside(page: str, link: str) -> str | None:
    """The file of the repository that a page's link names, or None within the documentation.

    Raises:
        FileNotFoundError: If there is no such file: a link is never lost unnoticed.
    """
    target = ((ROOT / "docs" / page).parent / link).resolve()
    if target.is_relative_to(ROOT / "docs"):
        return None
    if not target.exists():
        raise FileNotFoundError(f"{page} links to {link}, which is not there")
    return target.relative_to(ROOT).as_posix()


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links that leave the documentation keep their words and say which file they name; pictures point at the site's.

    Raises:
        FileNotFoundError: If there is no such file.
    """
    source = page.file.src_uri

    def plain(link: re.Match[str]) -> str:
        name = _outside(source, link[2])
        if name is None:
            return link[0]
        return link[1] if name.rstrip("/") in link[1] else f"{link[1]} (`{name}` in the repository)"

    def taken(picture: re.Match[str]) -> str:
        name = _outside(source, picture[2])
        if name is None:
            return picture[0]
        return f"{picture[1]}{posixpath.relpath(f'{PICTURES}/{name}', posixpath.dirname(source))})"

    return _LINK.sub(plain, _PICTURE.sub(taken, markdown))
