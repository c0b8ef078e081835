"""The plan of a run through the whole pipeline: budgets, datasets, policies, and the rows of its table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Budget:
    """Size of a run.

    Attributes:
        demonstrations: Training paths (ring) or pairs of demonstrations in all (robots) in each dataset.
        steps: Training steps of each policy, batches of 128.
        save_freq: Steps between checkpoints.
        pairs: Sample pairs per test condition for trained policies and the reference.
    """

    demonstrations: int
    steps: int
    save_freq: int
    pairs: int


@dataclass(frozen=True)
class PlannedDataset:
    """A dataset to record.

    Attributes:
        name: Its folder.
        env_id: Environment id.
        env_kwargs: Keyword arguments of the environment.
        size: The recorder's argument for its size.
    """

    name: str
    env_id: str
    env_kwargs: dict[str, Any]
    size: str = "episodes"


@dataclass(frozen=True)
class PlannedPolicy:
    """A policy to train: its folder name, its dataset's name, and flags of ``dualhead train``."""

    name: str
    dataset: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlannedRow:
    """One line of the story: which policy, sampled how, and what it should show.

    Attributes:
        name: File name of its gates.
        title: What the line is, in the table.
        policy: Name of the trained policy.
        source_noise_beta: Coupling chosen at sampling: 1 private noise, 0 shared noise.
        reference: Options of the exact reference, or None where there is none.
        story: What a newcomer should take from the line.
    """

    name: str
    title: str
    policy: str
    story: str
    source_noise_beta: float = 1.0
    reference: dict[str, Any] | None = field(default_factory=dict)


@dataclass(frozen=True)
class Plan:
    """A run through the whole pipeline.

    Attributes:
        what_is_recorded: The recording stage in words; ``{n}`` is the number of demonstrations.
        datasets, policies, rows: What is recorded, trained and evaluated.
        budgets: Its size by preset.
    """

    what_is_recorded: str
    datasets: tuple[PlannedDataset, ...]
    policies: tuple[PlannedPolicy, ...]
    rows: tuple[PlannedRow, ...]
    budgets: Mapping[str, Budget]
