"""Provenance of a policy: what a gate file or a recording says of where it came from."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import draccus
import numpy as np

from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.training.checkpoints import had_fresh_paths

#: Relative change of the loss, from one tenth of the log to the next, below which it counts as plateaued.
PLATEAU_CHANGE = 0.01


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
        "training": training_summary(folder),
    }


def training_summary(folder: Path) -> dict[str, Any]:
    """What is known of the run that wrote a checkpoint.

    Args:
        folder: The checkpoint's ``pretrained_model`` folder.

    Returns:
        ``batch_size``, ``steps`` (the run's budget), ``seed`` and ``fresh_paths`` where the folder holds its training
        configuration; ``final_loss``, ``plateaued`` and ``judged_loss`` where the run's log is at hand. The flow loss
        is judged (``judged_loss`` is ``"flow_loss"``), because free bits and a prior's cross-entropy move the total
        loss too; logs without it are judged on the total loss (``"loss"``). A loss counts as plateaued when the last
        tenth of the log is within 1 % of the tenth before it.
    """
    summary: dict[str, Any] = {}
    configuration = folder / "train_config.json"
    if configuration.is_file():
        content = json.loads(configuration.read_text(encoding="utf-8"))
        summary = {name: content.get(name) for name in ("batch_size", "steps", "seed")}
        summary["fresh_paths"] = had_fresh_paths(folder.parent)
    log = folder.parents[2] / "training_log.jsonl" if len(folder.parents) >= 3 else None
    if log is None or not log.is_file():
        return summary
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines() if line]
    if not lines:
        return summary
    judged = "flow_loss" if all("flow_loss" in line for line in lines) else "loss"
    losses = [line[judged] for line in lines]
    tenth = max(1, len(losses) // 10)
    last = float(np.mean(losses[-tenth:]))
    before = float(np.mean(losses[-2 * tenth : -tenth])) if len(losses) >= 2 * tenth else None
    plateaued = before is not None and abs(before - last) <= PLATEAU_CHANGE * abs(before)
    return summary | {"final_loss": last, "plateaued": plateaued, "judged_loss": judged}


def _fingerprint(weights: Path) -> str:
    """The sha256 of a checkpoint's weights, by which two evaluations of one checkpoint are told from two seeds."""
    with weights.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
