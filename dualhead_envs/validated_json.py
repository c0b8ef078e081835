"""JSON files that come from outside, checked against a schema before anything of them is used.

Every format of this project has one schema, a pydantic model that derives from :class:`Schema`, and is read through
:func:`read_validated`. What does not fit is refused in one sentence that names the file, the field, what was given
and what was expected.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, StringConstraints, TypeAdapter, ValidationError

#: Largest JSON file that is opened, in bytes; a gate file of the frozen protocol has 0.1 MB.
MAX_BYTES = 256 * 2**20
#: Deepest nesting of a JSON file; ours have 6.
MAX_DEPTH = 64


class Schema(BaseModel):
    """One of our formats: no unknown fields, no conversions, no NaN and no infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class OpenSchema(Schema):
    """The part that we need of a format that is not ours, or that later versions may add to."""

    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False, frozen=True)


def printable(text: str) -> str:
    """``text``, if it is a line of text that cannot steer a terminal.

    Raises:
        ValueError: If it has line breaks or control codes.
    """
    if not text.isprintable():
        raise ValueError("should be printable text without line breaks or control codes")
    return text


#: Longest label, in characters.
LONGEST_LABEL = 200
#: A name or label: a line of text that cannot steer a terminal.
Label = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_LABEL), AfterValidator(printable)]


def read_validated[T](path: Path, schema: type[T], *, kind: str, remedy: str) -> T:
    """The content of a JSON file.

    Args:
        path: The file.
        schema: A pydantic model, or any type that pydantic can check.
        kind: What the file should be, for errors: ``"a gate file"``.
        remedy: What to do about a file that is none, for errors: ``"record the dataset again"``.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not JSON, or does not fit the schema.
    """
    return validated(read_json(path, kind=kind, remedy=remedy), schema, source=str(path), remedy=remedy)


def read_json(path: Path, *, kind: str, remedy: str) -> Any:
    """A JSON document of bounded size and depth, without NaN, infinity or a key given twice.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no such document.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist, expected {kind}: {remedy}")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes, expected {kind} of at most {MAX_BYTES}: {remedy}")
    try:
        text = path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not JSON (byte {error.start} is not UTF-8), expected {kind}: {remedy}") from error
    return parse_json(text, source=str(path), kind=kind, remedy=remedy)


def parse_json(text: str, *, source: str, kind: str, remedy: str) -> Any:
    """The JSON document in ``text``; see :func:`read_json`.

    Raises:
        ValueError: If it is no such document.
    """
    try:
        document = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
    except RecursionError as error:
        raise ValueError(f"{source} is nested too deeply, expected {kind}: {remedy}") from error
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise ValueError(f"{source} is truncated or not JSON ({where}), expected {kind}: {remedy}") from error
    except ValueError as error:
        raise ValueError(f"{source} {error}, expected {kind}: {remedy}") from error
    if _depth(document) > MAX_DEPTH:
        raise ValueError(f"{source} is nested deeper than {MAX_DEPTH}, expected {kind}: {remedy}")
    return document


def validated[T](document: Any, schema: type[T], *, source: str, remedy: str) -> T:
    """A JSON document as an instance of a schema.

    Args:
        document: What :func:`read_json` returned.
        schema: A pydantic model, or any type that pydantic can check.
        source: Where it was read, for errors.
        remedy: What to do about a misfit, for errors.

    Raises:
        ValueError: In one sentence about the first misfit.
    """
    try:
        # From text again: only there does strict checking take a list for a tuple and a string for an enumeration.
        return TypeAdapter(schema).validate_json(json.dumps(document), strict=True)
    except ValidationError as error:
        raise ValueError(f"{source} {misfit(error)}: {remedy}") from error


def misfit(error: ValidationError) -> str:
    """The first complaint of pydantic as the predicate of a sentence, without its line breaks and addresses."""
    first = error.errors(include_url=False)[0]
    field = ".".join(str(part) for part in first["loc"] if not str(part).startswith("function-"))
    kind, message = first["type"], first["msg"]
    if kind == "missing":
        return f"lacks the field {field!r}"
    if kind == "extra_forbidden":
        return f"has an unknown field {shown(field)}"
    if kind in ("value_error", "assertion_error"):
        reason = " ".join(str(first["ctx"]["error"]).split()) if "ctx" in first else message
        return f"has {field} = {shown(first['input'])}, which {reason}" if field else reason
    expected = message.removeprefix("Input should be ").removeprefix("Value should have ")
    return f"has {field or 'content'} = {shown(first['input'])}, expected {expected}"


def shown(value: Any, length: int = 60) -> str:
    """A value as an error may show it: shortened, on one line, control codes escaped."""
    short = reprlib.Repr(maxstring=length, maxother=length, maxlist=4, maxdict=3, maxlevel=2)
    text = short.repr(value)
    return text if text.isprintable() else ascii(text)[1:-1]


def _refuse_constant(name: str) -> None:
    raise ValueError(f"holds {name}, which is not a number of JSON")


def _unique(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise ValueError(f"holds the field {shown(key)} twice")
        result[key] = value
    return result


def _depth(document: Any) -> int:
    level, depth = [document], 0
    while level:
        level = [
            child
            for value in level
            if isinstance(value, dict | list)
            for child in (value.values() if isinstance(value, dict) else value)
            if isinstance(child, dict | list)
        ]
        depth += 1
    return depth
