"""What can be evaluated, opened by path: a dataset's conditions, a policy folder, the exact reference."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from dualhead_envs.dataset_frames import SplitFrames, read_split
from dualhead_eval.evaluation.labelled_pairs import ModePartition
from dualhead_eval.evaluation.open_loop import EvaluationProtocol, evaluate_sampler
from dualhead_eval.gate.gate import Gate
from dualhead_eval.residuals.distances import mode_direction
from dualhead_policy.representation import require_observations
from dualhead_policy.sampling import Sampler

if TYPE_CHECKING:
    from dualhead_policy.modeling_dualhead import DualheadPolicy


@dataclass(frozen=True)
class ConditionBank:
    """Conditions to evaluate under, and whose modes they have.

    Attributes:
        observation: Raw observations by LeRobot key, each (B, dim).
        pair_ids: (B,).
        partition: The environment's mode partition.
        kinematic_map: The dataset's or environment's map from head A's space to the position.
        target_probabilities: Mode frequencies of the data.
        direction: Direction that separates the modes of every condition (B, d), or None where a pair of
            demonstrations is incomplete.
        env_kwargs: Keyword arguments of the environment.
        provenance: Where the conditions came from.
    """

    observation: Mapping[str, np.ndarray]
    pair_ids: np.ndarray
    partition: ModePartition
    kinematic_map: str
    target_probabilities: list[float] | None
    direction: np.ndarray | None
    env_kwargs: dict[str, Any]
    provenance: dict[str, Any]


def environment_partition(frames: SplitFrames) -> ModePartition:
    """The mode partition of the environment that a split was recorded from.

    Raises:
        ValueError: If the dataset does not say which environment it comes from.
    """
    env_id = frames.sidecar.get("env_id")
    if env_id is None:
        raise ValueError(
            f"{frames.root} does not say which environment it comes from (no meta/dualhead.json): expected a "
            "dataset written by `dualhead record`"
        )
    env = gym.make(f"dualhead_envs:{env_id}", disable_env_checker=True, **frames.sidecar.get("env_kwargs", {}))
    partition = env.unwrapped.mode_partition  # type: ignore[attr-defined]
    env.close()
    return partition


def open_conditions(root: str | Path, limit: int | None = None) -> ConditionBank:
    """The branch points of a recorded split's pairs, the first ``limit`` of them.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it is not a demonstration dataset of this package.
    """
    frames = read_split(root)
    if not {"pair", "branch_step"} <= set(frames.labels):
        raise ValueError(
            f"{root} lacks the columns 'pair' and 'branch_step': expected a split written by `dualhead record`"
        )
    partition = environment_partition(frames)
    conditions = frames.conditions()
    windows = frames.mode_windows(frames.sidecar.get("horizon", 16))
    keep = slice(None, limit)
    return ConditionBank(
        observation={key: value[keep] for key, value in conditions.observation.items()},
        pair_ids=conditions.pair[keep],
        partition=partition,
        kinematic_map=frames.sidecar["layout"],
        target_probabilities=frames.sidecar.get("mode_probabilities"),
        direction=None if windows is None else mode_direction(windows[keep]),
        env_kwargs=frames.sidecar.get("env_kwargs", {}),
        provenance={
            "dataset": {
                "env_id": frames.sidecar["env_id"],
                "env_kwargs": frames.sidecar.get("env_kwargs", {}),
                "split": frames.sidecar.get("split"),
                "fingerprint": frames.fingerprint,
            }
        },
    )


@dataclass(frozen=True)
class Source:
    """A sampler ready to be evaluated, with what turns raw observations into its input, and the input's shapes."""

    sampler: Sampler
    preprocess: Callable[[Any], Mapping[str, Any]]
    kinematic_map: str
    provenance: dict[str, Any]
    input_features: Mapping[str, Any] = field(default_factory=dict)


def open_policy(path: str | Path, *, device: str = "cpu") -> Source:
    """A trained policy, from its hub folder or its training run's output folder.

    Raises:
        FileNotFoundError: If there is no policy.
        ValueError: If it is damaged or of another type.
    """
    from dualhead_policy.pretrained import load_policy, policy_folder

    folder = policy_folder(path)
    policy, preprocessor = load_policy(folder, device=device)
    return Source(
        policy,
        preprocessor,
        policy.representation.kinematic_map,
        {"method": "policy", **policy_provenance(policy, folder)},
        policy.config.input_features,
    )


def policy_provenance(policy: DualheadPolicy, folder: Path) -> dict[str, Any]:
    """A gate file's account of the policy loaded from ``folder``: configuration, weights, training steps and run."""
    import draccus

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


def open_exact_reference(bank: ConditionBank, **options: Any) -> Source:
    """The exact reference for the ring that ``bank`` was recorded from.

    Raises:
        ValueError: If the conditions are not the ring's.
    """
    from dualhead_eval.exact_reference import ExactReference

    family, _, representation = bank.kinematic_map.partition("/")
    if family != "ring":
        raise ValueError(
            f"the exact reference exists on the ring only, not for {bank.kinematic_map!r}: evaluate a policy"
        )
    names = ("mode_probabilities", "mode_angles", "path_spread")
    known = {name: bank.env_kwargs[name] for name in names if bank.env_kwargs.get(name) is not None}
    reference = ExactReference(bank.partition.n_modes, representation, **known, **options)
    return Source(reference, dict, reference.kinematic_map, reference.describe())


def evaluate_source(
    source: Source,
    bank: ConditionBank,
    protocol: EvaluationProtocol,
    *,
    label: str,
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate ``source`` under the conditions of ``bank``; see
    :func:`dualhead_eval.evaluation.open_loop.evaluate_sampler`.

    Raises:
        ValueError: If they have different layouts.
    """
    if source.kinematic_map != bank.kinematic_map:
        raise ValueError(
            f"the policy's layout is {source.kinematic_map!r}, the dataset's is {bank.kinematic_map!r}: evaluate "
            "on a dataset of the layout that the policy was trained on"
        )
    require_observations(source.input_features, {key: value.shape[1] for key, value in bank.observation.items()})
    return evaluate_sampler(
        source.sampler,
        source.preprocess,
        source.kinematic_map,
        bank.observation,
        bank.pair_ids,
        bank.partition,
        protocol,
        direction=bank.direction,
        target_probabilities=bank.target_probabilities,
        provenance={"label": label, **source.provenance, **bank.provenance},
        progress=progress,
    )


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
    from dualhead_policy.training.checkpoints import had_fresh_paths

    summary: dict[str, Any] = {}
    configuration = folder / "train_config.json"
    if configuration.is_file():
        content = json.loads(configuration.read_text(encoding="utf-8"))
        summary = {name: content.get(name) for name in ("batch_size", "steps", "seed")}
        summary["fresh_paths"] = had_fresh_paths(folder.parent)
    log = folder.parents[2] / "training_log.jsonl" if len(folder.parents) >= 3 else None
    if log is None or not log.is_file():
        return summary
    lines = [json.loads(line) for line in log.read_text().splitlines() if line]
    if not lines:
        return summary
    judged = "flow_loss" if all("flow_loss" in line for line in lines) else "loss"
    losses = [line[judged] for line in lines]
    tenth = max(1, len(losses) // 10)
    last = float(np.mean(losses[-tenth:]))
    before = float(np.mean(losses[-2 * tenth : -tenth])) if len(losses) >= 2 * tenth else None
    plateaued = before is not None and abs(before - last) <= 0.01 * abs(before)
    return summary | {"final_loss": last, "plateaued": plateaued, "judged_loss": judged}


def _fingerprint(weights: Path) -> str:
    """The sha256 of a checkpoint's weights, by which two evaluations of one checkpoint are told from two seeds."""
    with weights.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
