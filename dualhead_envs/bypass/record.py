"""Recording sets of demonstrations as LeRobotDatasets, in parallel, resumable, whole or not at all.

A set, or pair where there are two modes, is one demonstration a mode from one initial state.

Finished attempts are staged one by one in ``.<name>.recording`` beside the target; when there are enough, the three
splits and the card are assembled there and the whole folder is renamed. The result depends on the arguments alone,
neither on the number of processes nor on interruptions.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from itertools import count, islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.recording.episode import Episode
from dualhead_envs.recording.shards import ShardStore
from dualhead_envs.recording.staging import publish, staging_for
from dualhead_envs.worker_processes import end_with, interrupts_kept_from_workers, workers_ended_afterwards

#: Pairs in the paper's data sets (sec:envs): 350/75/75 and 168/36/36.
DEFAULT_PAIRS = {"BimodalBypass-v2": 500, "RotatingBypass-v3": 240}
#: Arguments of the environment that decide which modes there are to demonstrate, and how far apart.
MODE_KWARGS = ("ways", "obstacle", "amplitude")
#: Share of the pairs in each of val and test.
HELD_OUT = 0.15
HORIZON = 16
#: More rejections than this share of the pairs (and than ten) mean that something is wrong.
_TOO_MANY = 0.5


def split_sizes(pairs: int) -> dict[str, int]:
    """Pairs in train, val and test: 70%, 15%, 15%.

    Raises:
        ValueError: If there are fewer than three pairs.
    """
    if pairs < 3:
        raise ValueError(f"pairs={pairs} cannot fill train, val and test: record at least 3")
    held_out = max(1, round(HELD_OUT * pairs))
    return {"train": pairs - 2 * held_out, "val": held_out, "test": held_out}


def record_bypass(
    env_id: str,
    root: Path | str,
    *,
    pairs: int | None = None,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Path:
    """Record ``pairs`` initial states, every mode each, as ``root/{train,val,test}`` and ``root/card.json``.

    Args:
        env_id: ``"BimodalBypass-v2"`` or ``"RotatingBypass-v3"``.
        root: Folder of the data set; must not hold anything.
        pairs: Number of initial states (500 or 240 by default, as in the paper).
        seed: Seed of the initial states and amplitudes.
        env_kwargs: Arguments under which evaluation shall rebuild the environment (``tau``, ``control``, ...);
            ``ways`` says which modes are demonstrated, ``obstacle`` and ``amplitude`` how far aside they go.
        workers: Processes, as many as there are cores by default.
        progress: Whether to show a progress bar on standard error.

    Returns:
        ``root``.

    Raises:
        ValueError: If the environment or the number of pairs does not fit.
        FileExistsError: If ``root`` holds anything, or an unfinished recording with other arguments lies beside it.
        BlockingIOError: If another process is recording to ``root``.
        OSError: If the disk is full; what was recorded stays staged and a repeated call resumes.
        RuntimeError: If too many initial states are rejected.
    """
    root = Path(root).resolve()
    if env_id not in DEFAULT_PAIRS:
        raise ValueError(f"env_id={env_id!r} has no pairs to record: choose one of {sorted(DEFAULT_PAIRS)}")
    pairs = DEFAULT_PAIRS[env_id] if pairs is None else pairs
    sizes = split_sizes(pairs)
    if seed < 0 or (workers is not None and workers < 1):
        raise ValueError(f"seed={seed} and workers={workers} should be at least 0 and 1")
    env_kwargs = dict(env_kwargs or {})
    if env_kwargs.get("perturbation") is not None:
        raise ValueError(
            f"perturbation={env_kwargs['perturbation']!r} cannot be demonstrated, the scripted expert does not react: "
            "leave it out, and perturb rollouts of a policy"
        )
    env: Any = gym.make(f"dualhead_envs:{env_id}", **env_kwargs).unwrapped  # refuses bad arguments before any work
    configuration = {
        "recorder": "bypass/2", "env_id": env_id, "env_kwargs": env_kwargs, "pairs": pairs, "seed": seed,
        "versions": {name: version(name) for name in ("mujoco", "robosuite")},
    }  # fmt: skip
    with staging_for(root, configuration) as store:
        _simulate(store, env_id, _mode_kwargs(env_kwargs), pairs, seed, workers, progress)
        _assemble(store, root, env, sizes, env_kwargs, seed)
        store.discard()
    return root


def _simulate(
    store: ShardStore,
    env_id: str,
    mode_kwargs: tuple[tuple[str, Any], ...],
    pairs: int,
    seed: int,
    workers: int | None,
    progress: bool,
) -> None:
    """Attempt initial states, in order, until ``pairs`` of them are accepted; one shard an attempt."""
    from joblib import Parallel, delayed
    from tqdm import tqdm

    finished = set(store.names())
    accepted = sum(bool(store.read(name)) for name in finished)
    rejected = len(finished) - accepted
    attempts = (attempt for attempt in count() if _shard(attempt) not in finished)
    end_with_this = {"initializer": end_with, "initargs": (os.getpid(),)}
    pool = Parallel(workers or _cores(), backend="loky", return_as="generator", batch_size=1, **end_with_this)
    bar = tqdm(total=pairs, initial=accepted, unit="pair", desc=env_id, disable=not progress, smoothing=0.05)
    with workers_ended_afterwards(), bar:
        bar.set_postfix(rejected=rejected)
        # As many as are missing at a time: nothing is simulated in vain, and rejections get another round.
        while accepted < pairs:
            batch = islice(attempts, pairs - accepted)
            with interrupts_kept_from_workers():
                results = pool(delayed(_attempt)(env_id, mode_kwargs, seed, attempt) for attempt in batch)
            for attempt, episodes in results:
                store.write(_shard(attempt), episodes)
                accepted += bool(episodes)
                rejected += not episodes
                bar.update(bool(episodes))
                bar.set_postfix(rejected=rejected)
            if rejected > max(10, _TOO_MANY * pairs):
                raise RuntimeError(
                    f"{rejected} of {accepted + rejected} initial states of {env_id} were rejected: the scripted "
                    "expert no longer solves this scene, check the versions of robosuite and mujoco"
                )


def _assemble(
    store: ShardStore, root: Path, env: Any, sizes: Mapping[str, int], env_kwargs: dict[str, Any], seed: int
) -> None:
    from dualhead_envs.bypass.card import geometry_card
    from dualhead_envs.recording.assembly import assemble

    pairs, rejections = _first_pairs(store, sum(sizes.values()))
    folder = store.folder / "dataset"
    shutil.rmtree(folder, ignore_errors=True)  # left by a kill during the assembly
    folder.mkdir()
    starts = np.cumsum([0, *sizes.values()])
    splits = {split: pairs[start : start + size] for (split, size), start in zip(sizes.items(), starts, strict=False)}
    for split in sizes:
        info = {
            "env_id": env.bypass.env_id, "env_kwargs": env_kwargs, "split": split, "seed": seed,
            "conditions_seed": seed, "horizon": HORIZON,
            "mode_probabilities": [1 / env.mode_partition.n_modes] * env.mode_partition.n_modes,
            "partition": env.mode_partition.to_dict(), "rejections": rejections,
        }  # fmt: skip
        assemble(splits[split], folder / split, env.layout, info, task=env.task_description)
    card = geometry_card(
        env.bypass.env_id, splits, env.mode_partition, rejections, has_obstacle=env.bypass.has_obstacle
    )
    write_atomically(folder / "card.json", json.dumps(card, indent=2) + "\n")
    publish(folder, root)


def _first_pairs(store: ShardStore, number: int) -> tuple[list[tuple[Episode, ...]], int]:
    """The first ``number`` accepted pairs in the order of their attempts, numbered anew, and the rejections."""
    pairs: list[tuple[Episode, ...]] = []
    rejections = 0
    for name in store.names():
        episodes = store.read(name)
        if not episodes:
            rejections += 1
            continue
        pairs.append(tuple(replace(episode, pair=len(pairs)) for episode in episodes))
        if len(pairs) == number:
            break
    return pairs, rejections


def _attempt(
    env_id: str, mode_kwargs: tuple[tuple[str, Any], ...], seed: int, attempt: int
) -> tuple[int, list[Episode]]:
    """The episodes of one initial state, one a mode, or none if a mode failed."""
    from dualhead_envs.bypass.demonstrations import demonstrate_modes

    env = _expert_env(env_id, mode_kwargs)
    pair = demonstrate_modes(env, int(np.random.SeedSequence(seed, spawn_key=(attempt,)).generate_state(1)[0]))
    if not pair.success:
        return attempt, []
    initial = env.initial_state
    drawn_second = initial.route_azimuth >= 0.5 * np.pi
    return attempt, [
        Episode(
            observation_state=np.array(demonstration.agent_pos[:-1]),
            environment_state=np.array(demonstration.environment_state[:-1]),
            action=demonstration.actions(),
            mode=mode,
            pair=attempt,
            branch_step=pair.branch_step,
            extra={
                "amplitude": pair.amplitude,
                "apex_error": demonstration.apex_error,
                "overshoot": demonstration.overshoot,
                "clearance": demonstration.clearance,
                "drawn_second": float((mode == 1) != drawn_second),
            },
        )
        for mode, demonstration in enumerate(pair.demonstrations)
    ]


@cache
def _expert_env(env_id: str, mode_kwargs: tuple[tuple[str, Any], ...]) -> Any:
    """The environment that the expert acts in; made once in every process."""
    return gym.make(f"dualhead_envs:{env_id}", control="pose", **dict(mode_kwargs)).unwrapped


def _mode_kwargs(env_kwargs: Mapping[str, Any]) -> tuple[tuple[str, Any], ...]:
    return tuple((name, env_kwargs[name]) for name in MODE_KWARGS if name in env_kwargs)


def _shard(attempt: int) -> str:
    return f"{attempt:06d}"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
