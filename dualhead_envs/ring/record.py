"""Demonstrations of the ring: the scripted expert drives the native vector environment.

Every episode is a function of a seed and its own number, so that the data do not depend on the size of the
shards, nor on where a recording was interrupted. The train split depends on ``seed``; the frozen bank (val
and test) depends on ``bank_seed`` alone, and a smaller bank is the beginning of a larger one.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.recording.assembly import assemble
from dualhead_envs.recording.episode import Episode
from dualhead_envs.recording.shards import ShardStore
from dualhead_envs.recording.staging import publish, staging_for
from dualhead_envs.ring.card import ring_card
from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.geometry import HORIZON
from dualhead_envs.ring.vector_env import RotatingRingVectorEnv

_STREAMS = {"train": 0, "val": 1, "test": 2}
_BLOCK = 1024  # conditions that are drawn from one random stream


def record_ring(
    env_id: str,
    root: Path | str,
    *,
    episodes: int = 3000,
    conditions: int = 75,
    seed: int = 0,
    bank_seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    shard_size: int = 1000,
    progress: bool = False,
) -> Path:
    """Record ``root/{train,val,test}`` and ``root/card.json``; resumes an interrupted recording.

    In the train split every episode has its own condition, and a mode from the prior; in val and test every
    condition has one episode a mode. No episode is rejected: a path that the partition calls invalid is part
    of the mixture that the exact reference knows, and ``card.json`` counts such paths.

    Args:
        env_id: A ``RotatingRing`` id.
        root: Output folder; must not hold anything.
        episodes: Paths in the train split.
        conditions: Conditions in each of val and test.
        seed: Seed of the train split.
        bank_seed: Seed of val and test.
        env_kwargs: Keyword arguments of the environment; ``control`` is how the expert drives it.
        shard_size: Conditions in a shard; changes nothing but how much an interruption costs.
        progress: Show a progress bar on standard error.

    Returns:
        ``root``, absolute.

    Raises:
        FileExistsError: If ``root`` holds anything, or an unfinished recording with other arguments.
        BlockingIOError: If another process records into ``root``.
        ValueError: If an argument is out of its range.
    """
    for name, value, least in (
        ("episodes", episodes, 1),
        ("conditions", conditions, 1),
        ("shard_size", shard_size, 1),
        ("seed", seed, 0),
        ("bank_seed", bank_seed, 0),
    ):
        if value < least:
            raise ValueError(f"{name}={value} is too small: pass at least {least}")
    if "n_modes" in (env_kwargs or {}):
        raise ValueError("env_kwargs has n_modes, which the id decides: choose the RotatingRing id of that number")

    def make(num_envs: int) -> RotatingRingVectorEnv:
        env = gym.make_vec(f"dualhead_envs:{env_id}", num_envs=num_envs, **dict(env_kwargs or {}))
        if not isinstance(env, RotatingRingVectorEnv):
            raise ValueError(f"{env_id} is not a RotatingRing environment: choose a RotatingRing id")
        return env

    root = Path(root).resolve()
    ring = make(1).ring
    sizes = {"train": episodes, "val": conditions, "test": conditions}
    seeds = {"train": seed, "val": bank_seed, "test": bank_seed}
    configuration = {
        "recorder": "ring/1",
        "env_id": env_id,
        "env_kwargs": ring.settings,
        "sizes": sizes,
        "seeds": seeds,
        "shard_size": shard_size,
    }
    with staging_for(root, configuration) as store:
        _record_shards(store, make, sizes, seeds, shard_size, progress)
        dataset = store.folder / "dataset"
        shutil.rmtree(dataset, ignore_errors=True)
        dataset.mkdir()
        splits = {}
        for split in sizes:
            shards = [store.read(name) for name in store.names() if name.startswith(split)]
            splits[split] = [episode for shard in shards for episode in shard]
            info = {
                "env_id": env_id,
                "env_kwargs": ring.settings,
                "split": split,
                "seed": seeds[split],
                "conditions_seed": seeds[split],
                "horizon": HORIZON,
                "mode_probabilities": list(ring.generator.probabilities),
                "partition": ring.partition.to_dict(),
                "rejections": 0,
            }
            assemble(shards, dataset / split, ring.layout, info, task=ring.description)
        card = ring_card(env_id, splits, ring.layout)
        write_atomically(dataset / "card.json", json.dumps(card, indent=2) + "\n")
        publish(dataset, root)
        store.discard()
    return root


def _record_shards(
    store: ShardStore,
    make: Callable[[int], RotatingRingVectorEnv],
    sizes: Mapping[str, int],
    seeds: Mapping[str, int],
    shard_size: int,
    progress: bool,
) -> None:
    """Record those shards that ``store`` does not hold yet."""
    finished = set(store.names())
    with tqdm(total=sum(sizes.values()), unit=" conditions", desc="recording", disable=not progress) as bar:
        for split, size in sizes.items():
            for start in range(0, size, shard_size):
                stop = min(start + shard_size, size)
                name = f"{split}-{start:09d}"
                if name not in finished:
                    store.write(name, _record(make, split, seeds[split], start, stop))
                bar.update(stop - start)


def _record(
    make: Callable[[int], RotatingRingVectorEnv], split: str, seed: int, start: int, stop: int
) -> list[Episode]:
    """The episodes of conditions ``start`` to ``stop - 1`` of a split, as the environment measures them."""
    generator = make(1).generator
    blocks = range(start // _BLOCK, -(-stop // _BLOCK))
    drawn = [_draw(generator, split, seed, block) for block in blocks]
    rows = slice(start - blocks.start * _BLOCK, stop - blocks.start * _BLOCK)
    condition, mode, path = (np.concatenate(parts)[rows] for parts in zip(*drawn, strict=True))

    env = make(mode.size)
    state = np.repeat(condition, mode.shape[1], axis=0)
    observation, _ = env.reset(options={"state": {"environment_state": state}})
    path = path.reshape(-1, HORIZON, 2)
    command = env.ring.map.from_position(path) if env.ring.control == "joint" else path
    positions = [observation["agent_pos"]]
    for step in range(HORIZON):
        observation, _, _, _, info = env.step(command[:, step].astype(np.float32))
        if info["collision"].any():
            spread = generator.path_spread
            raise ValueError(f"path_spread={spread} leads the expert out of the arena: choose less")
        positions.append(observation["agent_pos"])
    measured = np.stack(positions, axis=1)
    joint = env.ring.map.from_position(measured[:, 1:]).astype(np.float32)
    action = np.concatenate([joint, measured[:, 1:]], axis=-1)
    context = np.repeat(observation["environment_state"][:, None], HORIZON, axis=1)
    pair = np.repeat(np.arange(start, stop), mode.shape[1])
    return [
        Episode(
            measured[i, :-1],
            context[i],
            action[i],
            mode=int(mode.flat[i]),
            pair=int(pair[i]),
            branch_step=0,
            extra={"label": float(info["mode"][i])},
        )
        for i in range(mode.size)
    ]


def _draw(generator: RingGenerator, split: str, seed: int, block: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conditions (1024, 3), modes (1024, m) and paths (1024, m, 16, 2) of a block, m episodes a condition."""
    rng = np.random.default_rng([seed, _STREAMS[split], block])
    condition = generator.draw_conditions(rng, _BLOCK)
    if split == "train":
        mode = generator.draw_modes(rng, (_BLOCK, 1))
    else:
        mode = np.broadcast_to(np.arange(generator.n_modes), (_BLOCK, generator.n_modes))
    return condition, mode, generator.draw_paths(rng, condition[:, None], mode)
