"""Checkpoints in LeRobot's layout, written whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import torch
from lerobot.common.train_utils import get_step_checkpoint_dir, save_checkpoint
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.constants import CHECKPOINTS_DIR, LAST_CHECKPOINT_LINK, PRETRAINED_MODEL_DIR, TRAINING_STATE_DIR

from dualhead_policy.modeling_dualhead import DualheadPolicy

#: What a checkpoint says of its training windows, beside LeRobot's training state.
WINDOW_SOURCE_FILE = "window_source.json"


def write_checkpoint(
    cfg: TrainPipelineConfig,
    step: int,
    policy: DualheadPolicy,
    optimizer: torch.optim.Optimizer,
    scheduler: Any,
    processors: tuple[Any, Any],
    *,
    fresh_paths: bool = False,
) -> Path:
    """Write ``checkpoints/<step>`` under the output folder and point ``checkpoints/last`` at it.

    The folder is assembled beside its place and renamed into it, so that a kill leaves either no checkpoint of
    this step or a complete one.

    Returns:
        The checkpoint's ``pretrained_model`` folder.
    """
    assert cfg.output_dir is not None
    target = get_step_checkpoint_dir(Path(cfg.output_dir), cfg.steps, step)
    staging = target.with_name(f".{target.name}.partial")
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
    source = json.dumps({"fresh_paths": fresh_paths})
    (staging / TRAINING_STATE_DIR / WINDOW_SOURCE_FILE).write_text(source, encoding="utf-8")
    if target.exists():
        shutil.rmtree(target)
    os.replace(staging, target)
    link = target.with_name(f".{LAST_CHECKPOINT_LINK}.partial")
    link.unlink(missing_ok=True)
    link.symlink_to(target.name)
    os.replace(link, target.with_name(LAST_CHECKPOINT_LINK))
    return target / PRETRAINED_MODEL_DIR


def last_checkpoint(output_dir: str | Path) -> Path | None:
    """The newest complete checkpoint of a run, or None if it has none yet."""
    link = Path(output_dir) / CHECKPOINTS_DIR / LAST_CHECKPOINT_LINK
    return link.resolve() if link.exists() else None


def had_fresh_paths(checkpoint: Path) -> bool:
    """Whether a checkpoint was trained on fresh ring paths; False for checkpoints of ``lerobot-train``."""
    path = checkpoint / TRAINING_STATE_DIR / WINDOW_SOURCE_FILE
    return path.is_file() and bool(json.loads(path.read_text(encoding="utf-8")).get("fresh_paths", False))
