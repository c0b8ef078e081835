"""A griffe extension: docstrings are written for a terminal; on a page their examples and names are code."""

from __future__ import annotations

import re
from typing import Any

import griffe

_EXAMPLE = re.compile(r"(?:^[ ]*>>> .*\n?(?:^[ ]*\S.*\n?)*)(?:\n(?=[ ]*>>> )(?:^[ ]*\S.*\n?)+)*", re.MULTILINE)
_ROLE = re.compile(r":(?:mod|class|func|meth|attr|data):`(~?)([\w.]+)`")


class DocstringMarkup(griffe.Extension):
    """Put a fence around every example, and show what a role names as code."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            text = _ROLE.sub(_named, obj.docstring.value)
            obj.docstring.value = _EXAMPLE.sub(_fenced, text) if ">>>" in text else text


def _named(role: re.Match[str]) -> str:
    return f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`"


def _fenced(example: re.Match[str]) -> str:
    return f"```pycon\n{example[0].rstrip()}\n```\n"
