"""Many gate files in one: a line of names, then one gate document a line, through xz.

    {"format": "dualhead-gates/1", "names": [NAME, ...]}
    {"format": "dualhead-gate/1", "sha256": ..., "content": ...}

Gates of one dataset repeat its conditions and most of what is said about them: together they take a fourth of their own
files' bytes. Each keeps its checksum, and is held against the schema when it is asked for, as its own file would be.
"""

from __future__ import annotations

import json
import lzma
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from dualhead_envs.validated_json import Schema, parse_json, validated
from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.gate.file import document_of, verified_gate
from dualhead_eval.gate.gate import Gate

#: How a pack's name ends.
PACK_SUFFIX = ".gates.jsonl.xz"
FORMAT = "dualhead-gates/1"
KIND = "gate files in a pack"
REMEDY = "write it again with `dualhead study NAME --pack`, or take it from where it came from"
#: Largest text that is unpacked, in bytes: ten thousand gates of 75 conditions.
MAX_TEXT = 256 * 2**20
#: Memory that unpacking may take, in bytes: the strongest preset needs 65 MiB.
MAX_MEMORY = 128 * 2**20

#: A gate's name: a path below the pack's dataset, which can only lead down.
GateName = Annotated[str, Field(pattern=r"^[\w+-][\w.+-]*(/[\w+-][\w.+-]*){0,7}$", max_length=255)]


class PackHeader(Schema):
    """The first line of a pack."""

    format: str
    names: list[GateName]


class GatePack:
    """The gates in one pack, by name.

    Args:
        path: The pack.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged, too large, or no pack of this version.
    """

    def __init__(self, path: Path):
        if not path.is_file():
            raise FileNotFoundError(f"{path} does not exist, expected {KIND}: {REMEDY}")
        self.path = path
        # The empty string after the last line's end is no line.
        first, *lines = _text(path).removesuffix("\n").split("\n")
        header = validated(
            parse_json(first, source=f"line 1 of {path}", kind=KIND, remedy=REMEDY),
            PackHeader,
            source=f"line 1 of {path}",
            remedy=REMEDY,
        )
        if header.format != FORMAT:
            raise ValueError(f"{path} has format {header.format[:40]!r}, expected {FORMAT!r}: {REMEDY}")
        if len(lines) != len(header.names) or len(set(header.names)) < len(lines):
            raise ValueError(
                f"{path} names {len(set(header.names))} gates and holds {len(lines)}, expected each once: {REMEDY}"
            )
        self._lines = dict(zip(header.names, lines, strict=True))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its gates, in their order."""
        return tuple(self._lines)

    def __contains__(self, name: object) -> bool:
        return name in self._lines

    def source(self, name: str) -> Path:
        """What an error calls one of its gates."""
        return self.path / name

    def gate(self, name: str) -> Gate:
        """One of its gates.

        Raises:
            KeyError: If it has none of this name.
            ValueError: If that gate is damaged.
        """
        source = str(self.source(name))
        document = parse_json(self._lines[name], source=source, kind="a gate file", remedy=REMEDY)
        return verified_gate(document, source, REMEDY)


def write_pack(path: Path, gates: Mapping[str, Gate]) -> Path:
    """Write gates into a pack in one step, by name; the same gates give the same bytes, and a pack there is replaced.

    Args:
        path: The pack, ``*.gates.jsonl.xz``.
        gates: The gates by name, a path with slashes.

    Raises:
        ValueError: If a name leads elsewhere than down, or a gate cannot be written.
    """
    names = sorted(gates)
    header = validated({"format": FORMAT, "names": names}, PackHeader, source=str(path), remedy="choose other names")
    lines = [json.dumps(header.model_dump(), separators=(",", ":")), *(document_of(gates[name]) for name in names)]
    write_bytes(path, lzma.compress("".join(f"{line}\n" for line in lines).encode(), preset=9 | lzma.PRESET_EXTREME))
    return path


def _text(path: Path) -> str:
    """The text in a pack, of at most :data:`MAX_TEXT` bytes however far it would unpack."""
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=MAX_MEMORY)
    try:
        data = unpacker.decompress(path.read_bytes(), max_length=MAX_TEXT + 1)
    except lzma.LZMAError as error:
        raise ValueError(f"{path} is truncated or damaged ({error}), expected {KIND}: {REMEDY}") from error
    if len(data) > MAX_TEXT:
        raise ValueError(f"{path} unpacks to more than {MAX_TEXT} bytes, expected {KIND}: {REMEDY}")
    if not unpacker.eof or unpacker.unused_data:
        raise ValueError(f"{path} is truncated or has bytes behind its end, expected {KIND}: {REMEDY}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not JSON (byte {error.start} is not UTF-8), expected {KIND}: {REMEDY}") from error
