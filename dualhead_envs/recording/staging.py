"""From an output folder to its staging folder and back: claim, resume, publish, never overwrite."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dualhead_envs.recording.shards import ShardStore, sync_folder


@contextmanager
def staging_for(root: Path, configuration: Mapping[str, Any]) -> Iterator[ShardStore]:
    """The locked staging store of the output folder ``root``: a hidden sibling, ``.<name>.recording``.

    Shards of an interrupted recording with the same ``configuration`` are found in it.

    Raises:
        FileExistsError: If ``root`` holds anything, or an unfinished recording of another configuration.
        BlockingIOError: If another process records into ``root``.
        OSError: If the disk is full.
    """
    _refuse_occupied(root)
    with ShardStore(root.with_name(f".{root.name}.recording"), configuration) as store:
        try:
            _refuse_occupied(root)  # another process may have finished between the first look and the lock
            yield store
        except BaseException as error:
            if not store.names():  # nothing to resume
                store.discard()
            if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
                advice = "the disk is full: free some space and repeat the command, what was recorded is kept"
                raise OSError(error.errno, advice) from error
            raise


def publish(dataset: Path, root: Path) -> None:
    """Rename the finished ``dataset`` to ``root``, which must not hold anything.

    Raises:
        FileExistsError: If ``root`` has been filled in the meantime.
    """
    _refuse_occupied(root)
    dataset.rename(root)  # replaces an empty folder, and nothing else
    sync_folder(root.parent)


def _refuse_occupied(root: Path) -> None:
    if root.is_dir() and any(root.iterdir()):
        found = "a dataset" if (root / "card.json").exists() else "other files"
        raise FileExistsError(f"{root} already holds {found}: choose another output folder, or delete this one first")
    if root.exists() and not root.is_dir():
        raise FileExistsError(f"{root} is a file: choose another output folder")
