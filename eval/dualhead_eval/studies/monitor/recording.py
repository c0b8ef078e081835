"""The log of the study: episodes of a policy that is never monitored, a rollout dataset per part, recorded once."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed, parallel_config

from dualhead_envs.dataset_sidecar import SIDECAR, read_rollout_sidecar
from dualhead_envs.worker_processes import end_with, interrupts_kept_from_workers
from dualhead_eval.studies.monitor.registration import Budget, EnvName, Registration

CALIBRATION, NOMINAL = "calibration", "nominal"
#: Seeds between the first episodes of two parts.
SEEDS_APART = 1000


@dataclass(frozen=True)
class Part:
    """A part of the log: its folder's name, the seed of its first episode, its length and its perturbation."""

    name: str
    first_seed: int
    episodes: int
    perturbation: str | None = None


def parts(protocol: Registration, budget: Budget) -> list[Part]:
    """Calibration, nominal test episodes, and a part per kind and level of perturbation."""
    lengths: list[tuple[str, int, str | None]] = [
        (CALIBRATION, budget.calibration_episodes, None),
        (NOMINAL, budget.nominal_episodes, None),
    ]
    lengths += [(cell, budget.cell_episodes, cell) for cell in protocol.log.cells]
    first = protocol.log.first_seed
    return [Part(name, first + SEEDS_APART * i, n, cell) for i, (name, n, cell) in enumerate(lengths)]


def record_log(
    folder: Path,
    executor: Path,
    env: EnvName,
    protocol: Registration,
    budget: Budget,
    *,
    env_kwargs: dict[str, Any],
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> None:
    """Record every part that is not there yet; a part is there as a whole or not at all.

    Args:
        folder: The log's folder.
        executor: Folder of the policy that drives.
        env: Name of the environment in the registration.
        protocol: The protocol.
        budget: Its size.
        env_kwargs: Keyword arguments with which the demonstrations were recorded.
        jobs: Parts recorded at a time, each in a process of its own.
        progress: Called with the number of episodes of every part that is there.

    Raises:
        ValueError: If a part that is there was recorded from other seeds or under another perturbation.
    """
    env_id = protocol.environments[env].env_id
    kwargs = {**env_kwargs, "control": protocol.executor.control}
    missing = []
    for part in parts(protocol, budget):
        if (folder / part.name).exists():
            _require_same(folder / part.name, part, kwargs)
            if progress is not None:
                progress(part.episodes)
        else:
            missing.append(part)
    # The longest first, so that none of the processes ends alone.
    missing.sort(key=lambda part: -part.episodes)
    with parallel_config(backend="loky", initializer=end_with, initargs=(os.getpid(),)):
        parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="all")
        with interrupts_kept_from_workers():
            recorded = parallel(
                delayed(record_part)(folder, executor, part, env_id, kwargs, protocol.log.executor_samples)
                for part in missing
            )
        for episodes in recorded:
            if progress is not None:
                progress(episodes)


def record_part(folder: Path, executor: Path, part: Part, env_id: str, env_kwargs: dict[str, Any], samples: int) -> int:
    """Record one part; returns its number of episodes."""
    import torch

    from dualhead_eval.evaluation.closed_loop import record_rollouts
    from dualhead_policy.pretrained import load_policy, policy_folder
    from dualhead_policy.quiet import quiet_libraries
    from dualhead_policy.training.provenance import policy_provenance

    quiet_libraries()
    torch.set_num_threads(1)  # a network this small is slower on two
    policy, preprocess = load_policy(executor)
    record_rollouts(
        policy,
        preprocess,
        folder / part.name,
        env_id=env_id,
        env_kwargs=env_kwargs | ({"perturbation": part.perturbation} if part.perturbation else {}),
        episodes=part.episodes,
        samples=samples,
        seed=part.first_seed,
        provenance=policy_provenance(policy, policy_folder(executor)),
    )
    return part.episodes


def _require_same(root: Path, part: Part, env_kwargs: dict[str, Any]) -> None:
    sidecar = read_rollout_sidecar(root / SIDECAR)
    wanted = env_kwargs | ({"perturbation": part.perturbation} if part.perturbation else {})
    found = (sidecar["seed"], len(sidecar["outcomes"]), sidecar["env_kwargs"])
    if json.loads(json.dumps(found)) != json.loads(json.dumps((part.first_seed, part.episodes, wanted))):
        raise ValueError(
            f"{root} holds {found[1]} episodes from seed {found[0]} in {found[2]}, expected {part.episodes} from "
            f"{part.first_seed} in {wanted}: give the study another --output"
        )
