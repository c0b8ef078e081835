"""Checkpoints of a whole group: all of one step, or none.

Every run's checkpoint is staged first, then one file names them all, then they are published one by one. A kill
before the file leaves the former checkpoints of all; after it, publishing is done again.
"""

from __future__ import annotations

from pathlib import Path

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.validated_json import Schema, read_validated
from dualhead_policy.training.checkpoints import publish_checkpoint, staged
from dualhead_policy.training.stacked.stacked_training import StackedTraining


class Commit(Schema):
    """Checkpoints that are staged and belong together, as paths below the sweep's folder."""

    checkpoints: list[str]


def save_group(stack: StackedTraining, output: Path, commit_file: Path) -> None:
    """Save every run of a stack at its current step."""
    names = [str(checkpoint.relative_to(output)) for checkpoint in stack.stage()]
    write_atomically(commit_file, Commit(checkpoints=names).model_dump_json())
    publish_group(output, commit_file)


def publish_group(output: Path, commit_file: Path) -> None:
    """Publish what a commit file names, if there is one; a kill may have cut an earlier publishing short."""
    if not commit_file.is_file():
        return
    commit = read_validated(commit_file, Commit, kind="a group's commit", remedy="delete it and repeat the command")
    for name in commit.checkpoints:
        checkpoint = output / name
        if staged(checkpoint).is_dir() or checkpoint.is_dir():
            publish_checkpoint(checkpoint)
    commit_file.unlink()
