"""An exclusive claim on a folder: one process at a time writes in it, however the others end."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_LOCK = "lock"


@contextmanager
def claimed(folder: Path, product: Path | None = None) -> Iterator[Path]:
    """``folder``, created if need be, held by this process alone until the block or the process ends.

    Args:
        folder: The folder to hold; a file ``lock`` in it carries the claim.
        product: What is made in it, for the sentence that refuses a second process; ``folder`` by default.

    Raises:
        BlockingIOError: If another process holds it.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The holder before us may have discarded the folder between our two steps: our lock is then nobody's.
            held = os.path.samestat(os.fstat(descriptor), os.stat(folder / _LOCK))
        except (BlockingIOError, FileNotFoundError):
            held = False
        if not held:
            raise BlockingIOError(
                f"{product or folder} is in use by another process: wait for it, or choose another output folder"
            )
        yield folder
    finally:
        os.close(descriptor)


def discard(folder: Path) -> None:
    """Delete the claimed ``folder``; whoever looks meanwhile finds all of it or nothing."""
    doomed = folder.with_name(folder.name + ".discarded")
    shutil.rmtree(doomed, ignore_errors=True)
    folder.rename(doomed)
    shutil.rmtree(doomed)
