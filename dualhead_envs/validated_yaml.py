"""YAML files that people write: read safely and bounded, and held against a schema."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from dualhead_envs.validated_json import validated

#: Largest file that is read, in bytes.
MAX_BYTES = 2**20
#: Most values of a file, each alias counted as what it stands for.
MAX_VALUES = 10_000
#: Deepest nesting.
MAX_DEPTH = 32


def read_validated_yaml[T](path: Path, schema: type[T], *, what: str, remedy: str) -> T:
    """The content of a YAML file.

    Args:
        path: The file.
        schema: What it must fit.
        what: What it is, for the errors, for example ``"a study"``.
        remedy: What to do about a wrong one.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is too large, unpacks to too much, is not YAML, or does not fit the schema.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist, expected {what}'s YAML file: {remedy}")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes, expected {what} of at most {MAX_BYTES}: {remedy}")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path} is not YAML ({reason}): {remedy}") from error
    check_size(content, source=str(path), remedy=remedy)
    return validated(content, schema, source=str(path), remedy=remedy)


def check_size(content: Any, *, source: str, remedy: str) -> None:
    """Refuse a document that a few lines of aliases blow up: its own error message would fill the memory.

    Raises:
        ValueError: If it has more than :data:`MAX_VALUES` values or is nested deeper than :data:`MAX_DEPTH`.
    """
    if _values(content, MAX_DEPTH) > MAX_VALUES:
        raise ValueError(f"{source} holds more than {MAX_VALUES} values or is nested deeper than {MAX_DEPTH}: {remedy}")


def _values(value: Any, depth: int) -> int:
    """Number of values in a document, or one more than is allowed as soon as that is certain."""
    if depth == 0:
        return MAX_VALUES + 1
    children: Iterable[Any] = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    total = 1
    for child in children:
        total += _values(child, depth - 1)
        if total > MAX_VALUES:
            break
    return total
