"""YAML files that people write: read safely and bounded, and held against a schema."""

from __future__ import annotations

from pathlib import Path

import yaml

from dualhead_envs.validated_json import validated

#: Largest file that is read, in bytes.
MAX_BYTES = 2**20


def read_validated_yaml[T](path: Path, schema: type[T], *, what: str, remedy: str) -> T:
    """The content of a YAML file.

    Args:
        path: The file.
        schema: What it must fit.
        what: What it is, for the errors, for example ``"a study"``.
        remedy: What to do about a wrong one.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is too large, not YAML, or does not fit the schema.
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
    return validated(content, schema, source=str(path), remedy=remedy)
