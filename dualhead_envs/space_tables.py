"""Docstring tables that are generated from the layout, so that they cannot drift from the spaces."""

from __future__ import annotations

import re
from collections.abc import Callable


def with_space_tables[T: type](**tables: str) -> Callable[[T], T]:
    """Class decorator: replace each ``{name}`` that stands alone on a docstring line by ``tables[name]``."""

    def fill(cls: T) -> T:
        if cls.__doc__ is not None:  # None under `python -OO`
            cls.__doc__ = re.sub(
                r"^( *)\{(\w+)\}$",
                lambda match: "\n".join((match[1] + line).rstrip() for line in tables[match[2]].splitlines()),
                cls.__doc__,
                flags=re.MULTILINE,
            )
        return cls

    return fill
