"""What the regime sweep runs: its cells, its decisions, its criteria (``regimes.yaml``)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib.resources import as_file, files
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualhead_envs.ring import geometry
from dualhead_envs.validated_json import Label, Schema
from dualhead_envs.validated_yaml import read_validated_yaml
from dualhead_eval.monitor.thresholds.threshold import needed_episodes
from dualhead_eval.studies.monitor.registration import Inference, Seed, Share

#: Mean distance in m between the offsets of two paths of one mode: that of two draws of N(0, spread^2 I_2).
FLOOR = math.sqrt(math.pi) * geometry.PATH_SPREAD

Prior = Annotated[float, Field(ge=0.5, lt=1)]
Entropy = Annotated[float, Field(gt=0, le=math.log(2))]
Replacement = Annotated[float, Field(ge=0, le=1)]
#: At most that of opposite modes, 2 m apart.
Separation = Annotated[float, Field(gt=0, le=2 / FLOOR)]
Count = Annotated[int, Field(gt=0, le=10**7)]


class Cell(Schema):
    """A regime.

    Attributes:
        prior: Share of the first mode in the data of a flagged decision.
        token_entropy: Entropy in nat of the distribution from which tokens are drawn, the first mode's the likelier.
        replacement: Share of training tokens that a random one replaced.
        separation: Distance of the modes at radius 1 m, in units of :data:`FLOOR`.
    """

    prior: Prior
    token_entropy: Entropy
    replacement: Replacement
    separation: Separation

    @property
    def mode_angle(self) -> float:
        """Angle between the modes in radians."""
        return 2 * math.asin(min(1.0, self.separation * FLOOR / 2))


class SamplerOptions(Schema):
    """The exact reference's representation and Euler steps, and the seed of all draws."""

    representation: Literal["orthogonal", "nullspace"]
    euler_steps: Annotated[int, Field(gt=0, le=10_000)]
    seed: Seed


class Axes(Schema):
    """Levels of the four axes; every combination is a cell."""

    prior: Annotated[list[Prior], Field(min_length=1)]
    token_entropy: Annotated[list[Entropy], Field(min_length=1)]
    replacement: Annotated[list[Replacement], Field(min_length=1)]
    separation: Annotated[list[Separation], Field(min_length=1)]

    def cells(self) -> Iterator[Cell]:
        """Every combination, the separation varying fastest."""
        for values in product(self.prior, self.token_entropy, self.replacement, self.separation):
            yield Cell(**dict(zip(Cell.model_fields, values, strict=True)))


class Decisions(Schema):
    """Decisions per cell, arm and flagged share: calibration, flagged test and other test decisions."""

    calibration: Count
    flagged: Count
    other: Count


class PaperNull(Schema):
    """Cells at the paper's number of decisions; ``resolution`` is half the width of its interval."""

    flagged_share: Share
    decisions: Decisions
    resolution: Share
    cells: dict[Label, Cell]


class Inside(Schema):
    """R1: the least share of cells whose interval holds the prediction."""

    inside_interval: Share


class Vanishing(Schema):
    """R2: the gap at one separation is at most a share of that at another."""

    flagged_share: Share
    priors: list[Prior]
    separation: Separation
    against: Separation
    at_most: Share


class Removed(Schema):
    """R3: coordination takes away at least a share of the gap."""

    flagged_share: Share
    separation: Separation
    removed_at_least: Share


class Climb(Schema):
    """R4: the threshold over that of other decisions, where f x is at most ``below`` and at least ``above`` alpha."""

    separation: Separation
    below: float
    threshold_at_most: float
    above: float
    threshold_at_least: float


class PaperCells(Schema):
    """R5: cells of the paper's null in which nothing can be seen, and in which something can."""

    invisible: list[Label]
    visible: list[Label]


class Criteria(Schema):
    """The registered criteria."""

    R1: Inside
    R2: Vanishing
    R3: Removed
    R4: Climb
    R5: PaperCells


class RegimeSweep(Schema):
    """The sweep; ``docs/monitor_registration.md`` says in words what each field is for."""

    format: Literal["dualhead-monitor-regimes/1"]
    question: str
    sampler: SamplerOptions
    axes: Axes
    flagged_shares: Annotated[list[Share], Field(min_length=1)]
    alpha: Share
    decisions: Decisions
    inference: Inference
    paper: PaperNull
    criteria: Criteria

    @model_validator(mode="after")
    def _consistent(self) -> RegimeSweep:
        needed = needed_episodes(self.alpha)
        for decisions in (self.decisions, self.paper.decisions):
            if decisions.calibration < needed:
                raise ValueError(
                    f"calibrates on {decisions.calibration} decisions, expected at least {needed} at alpha {self.alpha}"
                )
        for name in (*self.criteria.R5.invisible, *self.criteria.R5.visible):
            if name not in self.paper.cells:
                raise ValueError(f"names the paper's cell {name!r}, expected one of {sorted(self.paper.cells)}")
        return self


def read_sweep(path: Path | None = None) -> RegimeSweep:
    """A sweep's definition, the registered one by default.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is none.
    """
    if path is None:
        with as_file(files("dualhead_eval.studies.monitor") / "regimes.yaml") as registered:
            return read_sweep(registered)
    remedy = "copy eval/dualhead_eval/studies/monitor/regimes.yaml and change its numbers"
    return read_validated_yaml(path, RegimeSweep, what="a regime sweep", remedy=remedy)
