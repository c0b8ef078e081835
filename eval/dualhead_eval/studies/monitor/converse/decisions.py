"""The decisions of held-out demonstrations: a grid of steps, and the steps at which both sides are still open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_envs.dataset_frames import SplitFrames
from dualhead_eval.studies.monitor.converse.protocol import Decisions


@dataclass(frozen=True)
class HeldOut:
    """Decisions of a split's demonstrations.

    Attributes:
        observation: Raw observations by LeRobot key, each ``(D, width)``.
        pair: Pair of each, numbered from 0 ``(D,)``.
        n_pairs: Number of pairs.
    """

    observation: dict[str, NDArray[np.float32]]
    pair: NDArray[np.int64]
    n_pairs: int


@dataclass(frozen=True)
class BothOpen(HeldOut):
    """Decisions that both demonstrations of a pair share.

    Attributes:
        separation: Mean distance of the two demonstrations over the next steps ``(D,)`` in mm.
        middle: Lateral coordinate between the two at the last of these steps ``(D,)`` in m.
    """

    separation: NDArray[np.float64]
    middle: NDArray[np.float64]


def grid_decisions(split: SplitFrames, decisions: Decisions, *, flagged: bool = True) -> HeldOut:
    """Every so many steps of every demonstration; without the flagged ones if told so."""
    step = split.frame_index
    chosen = step % decisions.every == 0
    if not flagged:
        chosen &= (step < decisions.flagged_from) | (step > decisions.flagged_to)
    frames = np.flatnonzero(chosen)
    return HeldOut(*_at(split, frames))


def flagged_decisions(split: SplitFrames, decisions: Decisions, horizon: int) -> BothOpen:
    """The flagged steps of every pair, once.

    Raises:
        ValueError: If the two demonstrations of a pair do not observe the same there, or go on too short.
    """
    steps = np.arange(decisions.flagged_from, decisions.flagged_to + 1)
    starts = np.flatnonzero(split.frame_index == 0)
    pairs = np.unique(split.labels["pair"])
    first, second = (_starts_of(split, starts, pairs, mode)[:, None] + steps for mode in (0, 1))
    frames, twins = first.ravel(), second.ravel()
    if not np.isin(np.concatenate([frames, twins]), split.window_starts(horizon)).all() or any(
        not np.array_equal(values[frames], values[twins]) for values in split.observation.values()
    ):
        raise ValueError(
            f"{split.root} holds pairs that part before step {decisions.flagged_to} or end within {horizon} steps of "
            "it, expected demonstrations of `dualhead record --env v2`: record them again"
        )
    position = [i for i, name in enumerate(split.action_names) if name.startswith("position.")]
    window = np.arange(horizon)
    left, right = (split.action[:, position][rows[:, None] + window].astype(np.float64) for rows in (frames, twins))
    return BothOpen(
        *_at(split, frames),
        separation=1000.0 * np.linalg.norm(left - right, axis=-1).mean(axis=-1),
        middle=0.5 * (left + right)[:, -1, 1],
    )


def _starts_of(split: SplitFrames, starts: NDArray[np.int64], pairs: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    own = starts[split.labels["mode"][starts] == mode]
    order = np.argsort(split.labels["pair"][own])
    if not np.array_equal(split.labels["pair"][own][order], pairs):
        raise ValueError(f"{split.root} lacks a demonstration of mode {mode}, expected one a pair: record it again")
    return own[order]


def _at(split: SplitFrames, frames: NDArray[np.int64]) -> tuple[dict[str, NDArray[np.float32]], NDArray[np.int64], int]:
    pairs = np.unique(split.labels["pair"])
    observation = {key: values[frames] for key, values in split.observation.items()}
    return observation, np.searchsorted(pairs, split.labels["pair"][frames]), len(pairs)
