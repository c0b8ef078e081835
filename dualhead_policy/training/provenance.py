"""Provenance of a policy: what a gate file or a recording says of where it came from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

import draccus
import numpy as np
from pydantic import Field

from dualhead_envs.validated_json import OpenSchema, read_validated
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.training.checkpoints import had_fresh_paths
from dualhead_policy.training.training_log import LOG_FILE, read_training_log

#: Relative change of the loss, from one tenth of the log to the next, below which it counts as plateaued.
PLATEAU_CHANGE = 0.01


class TrainedPolicy(OpenSchema):
    """What a gate file says of the policy's part of ``train_config.json``: the device on which it was trained."""

    device: str | None = None


class TrainingBudget(OpenSchema):
    """What a gate file says of a run, from LeRobot's ``train_config.json``."""

    batch_size: Annotated[int, Field(ge=1)] | None = None
    steps: Annotated[int, Field(ge=1)] | None = None
    seed: int | None = None
    policy: TrainedPolicy | None = None


class TrainingStep(OpenSchema):
    """LeRobot's ``training_state/training_step.json``."""

    step: Annotated[int, Field(ge=0)]


def policy_provenance(policy: DualheadPolicy, folder: Path) -> dict[str, Any]:
    """The configuration, weights, training steps and training run of the policy loaded from ``folder``."""
    config = draccus.encode(policy.config)
    # Where the policy ran and was read from is not part of what it is.
    for name in ("device", "pretrained_path"):
        config.pop(name, None)
    return {
        "config": config,
        "checkpoint": _fingerprint(folder / "model.safetensors"),
        "training_step": int(policy.training_step),
        "training": training_summary(folder, int(policy.training_step)),
    }


def lerobot_provenance(config: Any, folder: Path) -> dict[str, Any]:
    """The configuration, weights, training steps and training run of a policy of another LeRobot type."""
    encoded = draccus.encode(config, type(config))
    for name in ("device", "pretrained_path", "pretrained_revision", "repo_id"):
        encoded.pop(name, None)
    step = _saved_step(folder)
    return {
        "config": {**encoded, "type": config.type},
        "checkpoint": _fingerprint(folder / "model.safetensors"),
        "training_step": step,
        "training": training_summary(folder, step),
    }


def _saved_step(folder: Path) -> int | None:
    """The step of the training state that lies beside a checkpoint, None if there is none."""
    file = folder.parent / "training_state" / "training_step.json"
    if not file.is_file():
        return None
    kind = "the training step of a checkpoint"
    return read_validated(file, TrainingStep, kind=kind, remedy="copy the checkpoint again, or delete the file").step


def training_summary(folder: Path, step: int | None = None) -> dict[str, Any]:
    """What is known of the run that wrote a checkpoint, up to it.

    Args:
        folder: The checkpoint's ``pretrained_model`` folder.
        step: The checkpoint's training step: what the log says of later ones is not about it. None: the whole log.

    Returns:
        ``batch_size``, ``steps`` (the run's budget), ``seed``, ``device`` and ``fresh_paths`` where the folder holds
        its training configuration; ``final_loss``, ``plateaued`` and ``judged_loss`` where the run's log is at hand.
        The flow loss is judged (``judged_loss`` is ``"flow_loss"``), because free bits and a prior's cross-entropy
        move the total loss too; logs without it are judged on the total loss (``"loss"``). A loss counts as plateaued
        when the last tenth of the log is within 1 % of the tenth before it.
    """
    summary: dict[str, Any] = {}
    configuration = folder / "train_config.json"
    if configuration.is_file():
        kind = "a training configuration"
        remedy = "copy the checkpoint again, or delete the file"
        budget = read_validated(configuration, TrainingBudget, kind=kind, remedy=remedy)
        summary = budget.model_dump(exclude={"policy"})
        summary["device"] = budget.policy.device if budget.policy else None
        summary["fresh_paths"] = had_fresh_paths(folder.parent)
    log = folder.parents[2] / LOG_FILE if len(folder.parents) >= 3 else None
    lines = [] if log is None else [line for line in read_training_log(log) if step is None or line.step <= step]
    if not lines:
        return summary
    flow_losses = [line.flow_loss for line in lines if line.flow_loss is not None]
    judged = "flow_loss" if len(flow_losses) == len(lines) else "loss"
    losses = flow_losses if judged == "flow_loss" else [line.loss for line in lines]
    tenth = max(1, len(losses) // 10)
    last = float(np.mean(losses[-tenth:]))
    before = float(np.mean(losses[-2 * tenth : -tenth])) if len(losses) >= 2 * tenth else None
    plateaued = before is not None and abs(before - last) <= PLATEAU_CHANGE * abs(before)
    return summary | {"final_loss": last, "plateaued": plateaued, "judged_loss": judged}


def _fingerprint(weights: Path) -> str:
    """The sha256 of a checkpoint's weights, by which two evaluations of one checkpoint are told from two seeds."""
    with weights.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
