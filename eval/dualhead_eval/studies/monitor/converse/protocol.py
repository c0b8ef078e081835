"""The registered protocol of the converse, ``registration.yaml``, as the study reads it."""

from __future__ import annotations

from importlib.resources import files
from typing import Annotated, Literal

import yaml
from pydantic import Field, model_validator

from dualhead_envs.validated_json import Schema, validated
from dualhead_eval.studies.monitor.registration import Inference, PolicyFields, Seed, Share

SOURCE = "registration.yaml"
Positive = Annotated[int, Field(gt=0)]
Millimetres = Annotated[int, Field(ge=0, le=200)]
ArmName = Literal["A", "K"]
#: Side step in mm, arm and training seed of a policy.
Run = tuple[int, ArmName, int]
#: Names of the budgets.
Preset = Literal["full", "smoke"]


class ConverseBudget(Schema):
    """Size of a run: pairs of demonstrations a side step, training steps and seeds, and every arm's side steps."""

    pairs: Annotated[int, Field(ge=3)]
    steps: Positive
    seeds: Annotated[list[Seed], Field(min_length=1)]
    amplitudes_mm: dict[ArmName, list[Millimetres]]

    def runs(self) -> list[Run]:
        """Every run."""
        return [
            (amplitude, name, seed)
            for name, amplitudes in self.amplitudes_mm.items()
            for amplitude in amplitudes
            for seed in self.seeds
        ]


class Decisions(Schema):
    """Which control steps of a demonstration are decisions: every so many, and those that are flagged, inclusive."""

    every: Positive
    flagged_from: Annotated[int, Field(ge=0)]
    flagged_to: Annotated[int, Field(ge=0)]


class ConverseScoring(Schema):
    """Sampled pairs at a decision of the grid and at a flagged one, their seed, and the threshold's rate."""

    samples: Positive
    flagged_samples: Positive
    seed: Seed
    alpha: Share


class ConverseCriteria(Schema):
    """The margin within which a surcharge counts as none, and the ratio that divides C1 from C2."""

    equivalence: Share
    ratio: Annotated[float, Field(gt=0)]


class ConverseProtocol(Schema):
    """The protocol; ``docs/monitor_registration.md`` says in words what each field is for."""

    format: Literal["dualhead-monitor-converse/1"]
    question: str
    env_id: str
    obstacle: str
    record_seed: Seed
    arms: dict[ArmName, PolicyFields]
    presets: dict[Preset, ConverseBudget]
    decisions: Decisions
    scoring: ConverseScoring
    inference: Inference
    criteria: ConverseCriteria

    @model_validator(mode="after")
    def _consistent(self) -> ConverseProtocol:
        for name, budget in self.presets.items():
            if set(budget.amplitudes_mm) != set(self.arms) or 0 not in budget.amplitudes_mm["A"]:
                raise ValueError(
                    f"has no side steps of an arm, or not 0 mm of arm A, in {name!r}, expected both: A's surcharge is "
                    "graded against that of 0 mm"
                )
        return self


def registered_converse() -> ConverseProtocol:
    """The protocol that comes with this package."""
    text = files(__package__).joinpath(SOURCE).read_text(encoding="utf-8")
    return validated(yaml.safe_load(text), ConverseProtocol, source=SOURCE, remedy="install the package again")
