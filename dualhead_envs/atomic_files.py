"""Files that appear whole or not at all, and the sentence for those that could not be written."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

#: Errors of a disk, a quota or a limit on the size of files that is exhausted.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write ``content`` to ``path`` in one step: a reader, or a kill, finds the old file or the new one, never a part.

    Raises:
        OSError: If it cannot be written; says which file.
    """
    data = content.encode() if isinstance(content, str) else content
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".partial")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
        sync_folder(path.parent)
    except BaseException as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise not_written(path, error) from error
        raise


def sync_folder(folder: Path) -> None:
    """Flush ``folder``'s entries to the disk, so that a rename in it survives a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Flush every file and folder below ``folder`` to the disk."""
    for path in [*folder.rglob("*"), folder]:
        if path.is_dir():
            sync_folder(path)
        else:
            with open(path, "rb") as file:
                os.fsync(file.fileno())


def not_written(what: object, error: OSError, kept: str = "") -> OSError:
    """``error`` as a sentence that says what was being written and what to do.

    Args:
        what: The product, for example its path.
        error: Why it was not written.
        kept: What stands nevertheless, as a clause: ``"; checkpoint 2000 stands"``.
    """
    if error.errno in NO_ROOM:
        advice = "make room (or raise the limit on the size of files) and repeat the command"
    else:
        advice = "choose a place that can be written"
    reason = os.strerror(error.errno) if error.errno else error
    return OSError(error.errno, f"{what} could not be written ({reason}){kept}: {advice}")
