"""Which runs of a sweep train as one program: those whose tensors have the same shapes and meaning."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import draccus

from dualhead_envs.dataset_frames import data_files
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.sweep.sweep_file import SweepRun

#: Fields of DualheadConfig in which the runs of a group may differ: numbers of a run's own draws, loss or optimiser.
FREE_FIELDS = (
    "seed", "source_noise_beta", "optimizer_lr", "optimizer_grad_clip_norm", "lr_schedule", "lr_warmup_steps",
    "n_action_steps", "num_inference_steps", "dataset_name", "environment", "token_nmi", "repo_id", "tags", "private",
)  # fmt: skip
#: Fields in which they may differ while none or all of them are zero.
WEIGHT_FIELDS = (
    "observation_noise", "kl_weight", "free_bits", "consistency_weight", "rotation_consistency_weight",
)  # fmt: skip


@dataclass(frozen=True)
class PlannedRun:
    """A run with what identifies it.

    Attributes:
        run: The run.
        fingerprint: Of its configuration and data.
        stacking_key: Runs of one key can be stacked.
        steps: Its budget.
    """

    run: SweepRun
    fingerprint: str
    stacking_key: str
    steps: int


def plan_runs(runs: Sequence[SweepRun], output: Path, precision: str = "fp32") -> list[PlannedRun]:
    """Parse the configuration of every run, and say what it is.

    Where a run is trained (``policy.device``) is no part of what it is; the type in which it computes is.

    Args:
        runs: The runs.
        output: The sweep's folder.
        precision: ``"fp32"``, ``"tf32"`` or ``"bf16"``.

    Raises:
        ValueError: If a configuration is wrong; names it.
    """
    datasets = {run.dataset: dataset_signature(Path(run.dataset)) for run in runs}
    parsed: dict[tuple[str, ...], dict[str, Any]] = {}
    planned = []
    for run in runs:
        seedless = tuple(argument for argument in run.arguments if not argument.startswith("--seed="))
        if seedless not in parsed:
            try:
                cfg = parse_training_config([*seedless, f"--output_dir={output / '.plan'}"], run.preset)
            except (ValueError, OSError) as error:
                raise type(error)(f"configuration {run.name.rsplit('/', 1)[0]}: {error}") from error
            parsed[seedless] = draccus.encode(cfg)
        content = {
            name: value
            for name, value in parsed[seedless].items()
            if name not in ("output_dir", "job_name", "checkpoint_path", "wandb", "dataset", "num_workers")
        }
        signature = datasets[run.dataset]
        identity = run_identity(content | {"seed": run.seed}, signature["data"], run.fresh_paths, precision)
        key = [_structure(content), signature["shape"], run.fresh_paths, run.save_at]
        planned.append(PlannedRun(run, _digest(identity), _digest(key), content["steps"]))
    return planned


def run_identity(training: Mapping[str, Any], data: str, fresh_paths: bool, precision: str) -> dict[str, Any]:
    """What a run is: its configuration but for where it runs, its data, and the type in which it computes.

    >>> one, other = ({"steps": 9, "policy": {"device": device}} for device in ("cpu", "cuda"))
    >>> run_identity(one, "d", False, "fp32") == run_identity(other, "d", False, "fp32")
    True
    >>> run_identity(one, "d", False, "fp32") == run_identity(one, "d", False, "bf16")
    False
    """
    policy = {name: value for name, value in training["policy"].items() if name != "device"}
    return {
        "training": {**training, "policy": policy},
        "data": data,
        "fresh": fresh_paths,
        "precision": precision,
    }


def dataset_signature(root: Path) -> dict[str, Any]:
    """Digest of a training split's data, and the shape that stacked runs must share."""
    digest = hashlib.sha256()
    for path in data_files(root):
        digest.update(path.read_bytes())
    info = json.loads((root / "meta" / "info.json").read_text(encoding="utf-8"))
    sidecar_path = root / "meta" / "dualhead.json"
    sidecar = json.loads(sidecar_path.read_text(encoding="utf-8")) if sidecar_path.is_file() else {}
    features = {
        name: [feature.get("shape"), feature.get("names")]
        for name, feature in info["features"].items()
        if name == "action" or name.startswith("observation")
    }
    shape = [
        features, info.get("total_episodes"), info.get("total_frames"), sidecar.get("partition", {}).get("n_modes"),
        sidecar.get("env_kwargs", {}).get("representation"),
    ]  # fmt: skip
    return {"data": digest.hexdigest(), "shape": shape}


def make_groups(runs: Sequence[PlannedRun], *, size: int, jobs: int) -> list[list[PlannedRun]]:
    """Groups of at most ``size`` runs of one stacking key, enough of them to occupy ``jobs`` workers."""
    by_key: dict[str, list[PlannedRun]] = {}
    for run in runs:
        by_key.setdefault(run.stacking_key, []).append(run)
    groups = []
    for same in by_key.values():
        parts = max(math.ceil(len(same) / size), math.ceil(jobs / len(by_key)))
        width = math.ceil(len(same) / min(parts, len(same)))
        groups += [same[start : start + width] for start in range(0, len(same), width)]
    return groups


def _structure(content: Mapping[str, Any]) -> dict[str, Any]:
    """What decides the shapes of a run's tensors and the terms of its loss."""
    policy = dict(content["policy"])
    kept: dict[str, Any] = {name: content.get(name) for name in ("batch_size", "steps", "save_freq", "save_checkpoint")}
    for name in FREE_FIELDS:
        policy.pop(name, None)
    for name in WEIGHT_FIELDS:
        if policy.get(name) is not None:
            policy[name] = policy[name] > 0
    policy["corrupted"] = any(policy.pop(name) > 0 for name in ("token_replacement_prob", "token_null_prob"))
    policy["token_draw"] = policy["token_draw"] == "learned"
    return kept | {"policy": policy}


def _digest(content: Any) -> str:
    default: Callable[[Any], str] = str
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=default).encode()).hexdigest()[:16]
