"""From an output folder to its staging folder and back: claim, resume, publish, never overwrite."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dualhead_envs.atomic_files import NO_ROOM, not_written, sync_folder
from dualhead_envs.recording.claim import claimed, discard
from dualhead_envs.recording.shards import ShardStore


@contextmanager
def staging_folder(root: Path) -> Iterator[Path]:
    """An empty folder in which to make what :func:`publish` then renames to ``root``, for this process alone.

    It lies in a hidden sibling of ``root``, ``.<name>.partial``, which is emptied of what a killed process left and
    deleted at the end; only a product that could not be published, because ``root`` was filled meanwhile, stays there.

        with staging_folder(root) as folder:
            ...write folder / "dataset"...
            publish(folder / "dataset", root)

    Raises:
        FileExistsError: If ``root`` holds anything.
        BlockingIOError: If another process makes ``root``.
        OSError: If the disk is full.
    """
    refuse_occupied(root)
    with claimed(root.with_name(f".{root.name}.partial"), root) as partial, _naming_what_was_written(root, ""):
        folder = partial / "work"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        try:
            refuse_occupied(root)  # another process may have finished between the first look and the claim
            yield folder
        except BaseException as error:
            if not (isinstance(error, FileExistsError) and any(folder.iterdir())):
                discard(partial)
            raise
        discard(partial)


@contextmanager
def staging_for(root: Path, configuration: Mapping[str, Any]) -> Iterator[ShardStore]:
    """The claimed staging store of the output folder ``root``: a hidden sibling, ``.<name>.recording``.

    Shards of an interrupted recording with the same ``configuration`` are found in it.

    Raises:
        FileExistsError: If ``root`` holds anything, or an unfinished recording of another configuration.
        BlockingIOError: If another process records into ``root``.
        OSError: If the disk is full.
    """
    refuse_occupied(root)
    with (
        ShardStore(root.with_name(f".{root.name}.recording"), configuration) as store,
        _naming_what_was_written(root, "; what was recorded is kept"),
    ):
        try:
            refuse_occupied(root)  # another process may have finished between the first look and the claim
            yield store
        except BaseException:
            if not store.names():  # nothing to resume
                store.discard()
            raise


def publish(product: Path, root: Path) -> None:
    """Rename the finished folder ``product`` to ``root``, which must not hold anything.

    Raises:
        FileExistsError: If ``root`` has been filled in the meantime; ``product`` stays where it is.
    """
    try:
        refuse_occupied(root)
    except FileExistsError as error:
        raise FileExistsError(f"{error}; what was to become it is in {product}") from error
    product.rename(root)  # replaces an empty folder, and nothing else
    sync_folder(root.parent)


def refuse_occupied(root: Path) -> None:
    """Refuse an output folder that holds anything.

    Raises:
        FileExistsError: If ``root`` is a file, or a folder that is not empty.
    """
    if root.is_dir() and any(root.iterdir()):
        dataset = (root / "card.json").exists() or (root / "meta" / "info.json").exists()
        found = "a dataset" if dataset else "other files"
        raise FileExistsError(f"{root} already holds {found}: choose another output folder, or delete this one first")
    if root.exists() and not root.is_dir():
        raise FileExistsError(f"{root} is a file: choose another output folder")


@contextmanager
def _naming_what_was_written(root: Path, kept: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        raise not_written(root, error, kept) from error
