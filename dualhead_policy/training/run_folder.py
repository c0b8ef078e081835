"""What a run's output folder may hold when a training begins in it."""

from __future__ import annotations

import shutil
from pathlib import Path

from lerobot.utils.constants import CHECKPOINTS_DIR

from dualhead_policy.training.checkpoints import last_checkpoint
from dualhead_policy.training.training_log import LOG_FILE


def refuse_occupied(output_dir: Path) -> None:
    """Refuse to begin a run in a folder that holds anything but a start that came to no checkpoint.

    Raises:
        FileExistsError: If ``output_dir`` holds a run or other files, or is a file.
    """
    if not output_dir.exists():
        return
    if not output_dir.is_dir():
        raise FileExistsError(f"{output_dir} is a file: give another --output_dir")
    if last_checkpoint(output_dir) is not None:
        raise FileExistsError(
            f"{output_dir} already exists: continue it with --resume=true, or give another --output_dir"
        )
    others = sorted(path.name for path in output_dir.iterdir() if not _is_false_start(path))
    if others:
        raise FileExistsError(f"{output_dir} holds {others[0]}: give another --output_dir")


def clear_false_start(output_dir: Path) -> None:
    """Delete what a start that came to no checkpoint left, so that nothing of it mixes with the run that begins."""
    if output_dir.is_dir():
        for path in filter(_is_false_start, output_dir.iterdir()):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _is_false_start(path: Path) -> bool:
    return path.name in (CHECKPOINTS_DIR, LOG_FILE) or (path.name.startswith(f".{LOG_FILE}."))
