"""Checkpoints in LeRobot's layout, written whole or not at all."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from lerobot.common.train_utils import get_step_checkpoint_dir, save_checkpoint
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.constants import CHECKPOINTS_DIR, LAST_CHECKPOINT_LINK, PRETRAINED_MODEL_DIR, TRAINING_STATE_DIR
from safetensors import SafetensorError

from dualhead_envs.atomic_files import not_written, sync_tree
from dualhead_envs.validated_json import read_validated
from dualhead_policy.modeling_dualhead import DualheadPolicy

#: What a checkpoint says of its training windows, beside LeRobot's training state.
WINDOW_SOURCE_FILE = "window_source.json"


@dataclass(frozen=True)
class WindowOrigin:
    """Where a run's training windows come from.

    Attributes:
        dataset: Fingerprint of the training split.
        fresh_paths: Whether new ring paths are drawn at every step.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    dataset: str
    fresh_paths: bool = False


def write_checkpoint(
    cfg: TrainPipelineConfig,
    step: int,
    policy: DualheadPolicy,
    optimizer: torch.optim.Optimizer,
    scheduler: Any,
    processors: tuple[Any, Any],
    origin: WindowOrigin,
) -> Path:
    """Write ``checkpoints/<step>`` under the output folder and point ``checkpoints/last`` at it.

    The folder is assembled beside its place and renamed into it, so that a kill leaves either no checkpoint of
    this step or a complete one.

    Returns:
        The checkpoint's ``pretrained_model`` folder.

    Raises:
        OSError: If it cannot be written, for example because the disk is full; the last complete checkpoint stands.
    """
    assert cfg.output_dir is not None
    target = checkpoint_folder(cfg, step)
    with naming_what_stands(Path(cfg.output_dir), target):
        try:
            stage_checkpoint(cfg, step, policy, optimizer, scheduler, processors, origin)
            return publish_checkpoint(target)
        finally:
            shutil.rmtree(staged(target), ignore_errors=True)


def checkpoint_folder(cfg: TrainPipelineConfig, step: int) -> Path:
    """Where a run's checkpoint of ``step`` belongs."""
    assert cfg.output_dir is not None
    return get_step_checkpoint_dir(Path(cfg.output_dir), cfg.steps, step)


def staged(checkpoint: Path) -> Path:
    """Where a checkpoint is assembled before it is published."""
    return checkpoint.with_name(f".{checkpoint.name}.partial")


def stage_checkpoint(
    cfg: TrainPipelineConfig,
    step: int,
    policy: DualheadPolicy,
    optimizer: torch.optim.Optimizer,
    scheduler: Any,
    processors: tuple[Any, Any],
    origin: WindowOrigin,
) -> None:
    """Assemble the checkpoint that :func:`publish_checkpoint` puts into its place."""
    staging = staged(checkpoint_folder(cfg, step))
    shutil.rmtree(staging, ignore_errors=True)
    save_checkpoint(
        staging,
        step=step,
        cfg=cfg,
        policy=policy,
        optimizer=optimizer,
        scheduler=scheduler,
        preprocessor=processors[0],
        postprocessor=processors[1],
        num_processes=1,
        batch_size=cfg.batch_size,
    )
    state = staging / TRAINING_STATE_DIR
    (state / WINDOW_SOURCE_FILE).write_text(json.dumps(asdict(origin)), encoding="utf-8")
    sync_tree(staging)


def publish_checkpoint(checkpoint: Path) -> Path:
    """Put a staged checkpoint into its place and point ``checkpoints/last`` at it; again, if a kill cut it short.

    Returns:
        The checkpoint's ``pretrained_model`` folder.
    """
    if staged(checkpoint).is_dir():
        if checkpoint.exists():
            shutil.rmtree(checkpoint)
        os.replace(staged(checkpoint), checkpoint)
    point_last_at(checkpoint)
    return checkpoint / PRETRAINED_MODEL_DIR


def point_last_at(checkpoint: Path) -> None:
    """Make ``checkpoint`` the one that ``checkpoints/last`` names, in one step."""
    link = checkpoint.with_name(f".{LAST_CHECKPOINT_LINK}.partial")
    link.unlink(missing_ok=True)
    link.symlink_to(checkpoint.name)
    os.replace(link, checkpoint.with_name(LAST_CHECKPOINT_LINK))


def last_checkpoint(output_dir: str | Path) -> Path | None:
    """The newest complete checkpoint of a run, or None if it has none yet."""
    link = Path(output_dir) / CHECKPOINTS_DIR / LAST_CHECKPOINT_LINK
    return link.resolve() if link.exists() else None


def last_step(output_dir: str | Path) -> int:
    """The step of a run's newest complete checkpoint, 0 if it has none yet.

    Raises:
        ValueError: If the run was copied without its links, so that nothing says which checkpoint is the newest.
    """
    last = last_checkpoint(output_dir)
    if last is not None and not last.name.isdigit():
        raise ValueError(
            f"{last} is a folder, expected a link to a checkpoint: the run was copied without its links; copy it again "
            "with `cp -a`, or put a link to its newest checkpoint there"
        )
    return 0 if last is None else int(last.name)


@contextmanager
def naming_what_stands(output_dir: Path, what: Path) -> Iterator[None]:
    """Turn an error of writing ``what`` into a sentence that names it and the last complete checkpoint.

    Raises:
        OSError: If the body raises one, or safetensors' own.
    """
    try:
        yield
    except (OSError, SafetensorError) as error:
        last = last_checkpoint(output_dir)
        kept = f"the last complete checkpoint, {last.name}, stands" if last else "there is no complete checkpoint yet"
        raise not_written(what, _as_os_error(error), f"; {kept}") from error


def _as_os_error(error: OSError | SafetensorError) -> OSError:
    if isinstance(error, OSError):
        return error
    # safetensors has no class for an error of the operating system: its number is in the text.
    number = re.search(r"os error (\d+)", str(error))
    return OSError(int(number[1]), os.strerror(int(number[1]))) if number else OSError(str(error))


def window_origin(checkpoint: Path) -> WindowOrigin | None:
    """Where the windows of a checkpoint came from; None for checkpoints of ``lerobot-train``, which does not say.

    Raises:
        ValueError: If the file that says so is damaged.
    """
    path = checkpoint / TRAINING_STATE_DIR / WINDOW_SOURCE_FILE
    if not path.is_file():
        return None
    remedy = "resume from another checkpoint, or train again"
    return read_validated(path, WindowOrigin, kind="a description of training windows", remedy=remedy)


def had_fresh_paths(checkpoint: Path) -> bool:
    """Whether a checkpoint was trained on fresh ring paths; False for checkpoints of ``lerobot-train``."""
    origin = window_origin(checkpoint)
    return origin is not None and origin.fresh_paths
