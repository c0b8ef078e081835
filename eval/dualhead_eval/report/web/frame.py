"""The frame of a page: one file with its style and script inside, which asks no network for anything."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from importlib import resources

from dualhead_eval.report.table import printable


def text(content: str) -> str:
    """Content as text: its markup is escaped, its control codes are spelled out."""
    return escape(printable(content))


def document(title: str, body: str) -> str:
    """The whole page."""
    assets = resources.files("dualhead_eval.report.web")
    style, script = ((assets / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        # A browser asks for an icon unless the page brings one.
        '<link rel="icon" href="data:,">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n<script>\n{script}</script>\n</body>\n</html>\n"
    )


def folded(summary: str, content: str) -> str:
    """Content that is shown when its summary is opened."""
    return f"<details><summary>{text(summary)}</summary>\n{content}\n</details>"


def section(title: str, content: str) -> str:
    """A folded section under a heading of its own."""
    return f'<details class="section"><summary><h3>{text(title)}</h3></summary>\n{content}\n</details>'


def picture(png: bytes, caption: str) -> str:
    """An embedded picture with its caption."""
    data = base64.b64encode(png).decode()
    return (
        f'<figure><img alt="{text(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{text(caption)}</figcaption></figure>"
    )


def pictures(figures: Mapping[str, bytes], captions: Mapping[str, str]) -> str:
    """Embedded pictures by name, with their captions."""
    return "\n".join(picture(png, captions[name]) for name, png in figures.items())
