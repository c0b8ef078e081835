"""Compressed gate files: the same document through gzip, the same bytes for the same content, bounded when read."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path

#: How a gate file's name ends that is written compressed.
COMPRESSED_SUFFIX = ".gz"
#: Largest document that is unpacked, in bytes; a gate of 1,000 conditions has 0.2 MB.
MAX_DOCUMENT = 64 * 2**20


def is_compressed(path: Path) -> bool:
    """Whether a file of this name is written and read through gzip."""
    return path.name.endswith(COMPRESSED_SUFFIX)


def compress(text: str) -> bytes:
    """``text`` as a gzip file without name and time, so that the same text gives the same bytes."""
    buffer = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", fileobj=buffer, compresslevel=9, mtime=0) as file:
        file.write(text.encode())
    return buffer.getvalue()


def decompress(path: Path, *, kind: str, remedy: str) -> str:
    """The text in a gzip file, of at most :data:`MAX_DOCUMENT` bytes however far it would unpack.

    Raises:
        ValueError: If the file is damaged, unpacks to more, or is not text.
    """
    try:
        with gzip.open(path, "rb") as file:
            data = file.read(MAX_DOCUMENT + 1)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path} is truncated or damaged ({reason}), expected {kind}: {remedy}") from error
    if len(data) > MAX_DOCUMENT:
        raise ValueError(f"{path} unpacks to more than {MAX_DOCUMENT} bytes, expected {kind}: {remedy}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not JSON (byte {error.start} is not UTF-8), expected {kind}: {remedy}") from error
