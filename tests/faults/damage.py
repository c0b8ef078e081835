"""Ways in which a file can be bad: cut, overwritten, of another kind, or edited by a hand that knows its format."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Damage = Callable[[Path], None]
#: Text that clears the terminal it is printed on.
CONTROL = "\x1b[2J"
#: What a leaf or container of a JSON document is replaced by, by the type that it should have: never of that type.
WRONG: dict[type, tuple[Any, ...]] = {
    str: (3, CONTROL, ["a list"]),
    bool: ("yes", 3),
    int: ("3", 1.5, -(10**30)),
    float: ("a word", float("nan"), float("inf"), []),
    list: (3, {"an": "object"}),
    dict: (3, ["a list"]),
    type(None): ({"an": {"object": 1}},),
}


def byte_damages(size: int, rng: np.random.Generator) -> Iterator[tuple[str, Damage]]:
    """Damages of any file of text: truncations, bytes that no text holds, other files, and far too much."""
    for share in (0.0, 0.3, 0.7, 0.97):
        yield f"cut at {share:.0%}", _content(lambda whole, share=share: whole[: int(share * len(whole))])
    for byte in (0x00, 0xFF):
        for where in rng.integers(0, max(1, size - 2), size=2):
            yield f"byte {where} is {byte:#04x}", _content(_overwritten(int(where), byte))
    yield "a picture", _content(lambda whole: b"\x89PNG\r\n\x1a\n" + bytes(64))
    yield "a list", _content(lambda whole: b"[1, 2, 3]")
    yield "a word", _content(lambda whole: b'"word"')
    yield "nested without end", _content(lambda whole: b"[" * 200_000)
    yield "objects without end", _content(lambda whole: b'{"a":' * 50_000 + b"1" + b"}" * 50_000)


def binary_damages(size: int, rng: np.random.Generator) -> Iterator[tuple[str, Damage]]:
    """Damages of a file of numbers whose reader can notice them."""
    for share in (0.0, 0.2, 0.6, 0.99):
        yield f"cut at {share:.0%}", _content(lambda whole, share=share: whole[: int(share * len(whole))])
    yield "another kind of file", _content(lambda whole: b"PK\x03\x04" + bytes(200))
    yield "text", _content(lambda whole: b"step,loss\n1,2\n")
    yield "a length beyond reason", _content(lambda whole: b"\xff" * 8 + whole[8:])
    yield "zeros", _content(lambda whole: bytes(len(whole)))
    for where in rng.integers(0, min(size, 60), size=3):
        yield f"byte {where} of the head is 0xff", _content(_overwritten(int(where), 0xFF))


def json_damages(
    document: Any, rng: np.random.Generator, *, closed: bool = True, free: Sequence[str] = (), most: int = 60
) -> Iterator[tuple[str, Callable[[Any], None]]]:
    """Edits of a JSON document that its schema should refuse.

    Args:
        document: The document.
        rng: Chooses which of the edits, where there are more than ``most``.
        closed: Whether fields may neither be added nor left out.
        free: Beginnings of paths below which anything is allowed.
        most: Number of edits.
    """
    edits: list[tuple[str, Callable[[Any], None]]] = []
    for path, value in _walk(document):
        name = ".".join(map(str, path))
        if not path or any(name == part or name.startswith(part + ".") for part in free):
            continue
        for wrong in WRONG[type(value)]:
            edits.append((f"{name} = {str(wrong)[:20]!a}", _replaced(path, wrong)))
        if closed and isinstance(path[-1], str):
            edits.append((f"no {name}", _removed(path)))
        if closed and isinstance(value, dict):
            edits.append((f"{name}.stranger", _replaced((*path, "stranger"), 1)))
    chosen = rng.permutation(len(edits))[:most]
    yield from (edits[i] for i in sorted(chosen))


def edited(change: Callable[[Any], None]) -> Damage:
    """A damage that changes the JSON document in a file."""

    def apply(path: Path) -> None:
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    return apply


def doubled(path: Path) -> None:
    """Give the first field of a JSON object a second time."""
    text = path.read_text().lstrip()
    key = next(iter(json.loads(text)))
    path.write_text(f"{{{json.dumps(key)}: 1, {text[1:]}")


def _walk(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    yield path, value
    if isinstance(value, dict):
        for key, child in value.items():
            yield from _walk(child, (*path, key))
    elif isinstance(value, list):
        for index, child in enumerate(value[:3]):
            yield from _walk(child, (*path, index))


def _parent(document: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        document = document[key]
    return document


def _replaced(path: tuple[Any, ...], value: Any) -> Callable[[Any], None]:
    return lambda document: _parent(document, path).__setitem__(path[-1], value)


def _removed(path: tuple[Any, ...]) -> Callable[[Any], None]:
    return lambda document: _parent(document, path).__delitem__(path[-1])


def _content(change: Callable[[bytes], bytes]) -> Damage:
    return lambda path: path.write_bytes(change(path.read_bytes())) and None


def _overwritten(where: int, byte: int) -> Callable[[bytes], bytes]:
    return lambda whole: whole[:where] + bytes([byte]) + whole[where + 1 :]
