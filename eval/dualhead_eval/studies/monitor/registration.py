"""The registered protocol, ``registration.yaml``, as the study reads it."""

from __future__ import annotations

from importlib.resources import files
from typing import Annotated, Literal

import yaml
from pydantic import Field, model_validator

from dualhead_envs.validated_json import Schema, validated
from dualhead_eval.studies.study_file import ResampledRow

SOURCE, LATER_SOURCE, RESAMPLED_SOURCE = "registration.yaml", "later.yaml", "resampled.yaml"
PolicyFields = dict[str, str | int | float]
Seed = Annotated[int, Field(ge=0)]
#: Environments that the protocol names.
EnvName = Literal["v2", "v3"]
Share = Annotated[float, Field(gt=0, lt=1)]


class Environment(Schema):
    """An environment, and how many pairs of demonstrations are recorded in it, in full and in the smoke preset."""

    env_id: str
    pairs: Annotated[int, Field(gt=0)]
    smoke_pairs: Annotated[int, Field(gt=0)]


class Executor(Schema):
    """The policy that drives and is never monitored: its fields, its training seed, and the head that is executed."""

    policy: PolicyFields
    seed: Seed
    control: Literal["joint", "position"]


class Budget(Schema):
    """Size of a run.

    Attributes:
        steps: Training steps of every policy.
        seeds: Training seeds of every arm.
        calibration_episodes: Nominal episodes rolled out for calibration.
        calibration_kept: The first so many of them that succeeded calibrate.
        nominal_episodes: Nominal test episodes.
        cell_episodes: Test episodes of every kind and level of perturbation.
    """

    steps: Annotated[int, Field(gt=0)]
    seeds: list[Seed]
    calibration_episodes: Annotated[int, Field(gt=0)]
    calibration_kept: Annotated[int, Field(gt=0)]
    nominal_episodes: Annotated[int, Field(gt=0)]
    cell_episodes: Annotated[int, Field(gt=0, lt=1000)]


class Log(Schema):
    """The recording that every arm is scored on: its first seed, its perturbations, the executor's recorded pairs."""

    first_seed: Seed
    cells: list[str]
    executor_samples: Annotated[int, Field(ge=2)]


class Rule(Schema):
    """How scores add up over an episode, and which threshold their sum is compared with."""

    aggregator: str
    threshold: str


class Scoring(Schema):
    """How arms are sampled on the log, what is scored, and the two rules: per decision and per episode."""

    samples: Annotated[int, Field(ge=2)]
    seed: Seed
    signals: list[str]
    alpha: Share
    step: Rule
    episode: Rule


class Inference(Schema):
    """The bootstrap's draws and seed."""

    draws: Annotated[int, Field(gt=0)]
    seed: Seed


class Gate(Schema):
    """What an arm must offer on flagged decisions, or comparisons with it are "not tested"."""

    capacity: float
    token_entropy_nat: float
    obedience: float


class FalseAlarmCriterion(Schema):
    """The gap's difference must lie below a bound, and the arm's gap be at most a share of the baseline's."""

    measure: str
    signal: str
    upper_below: float
    at_most_share_of_baseline: float


class DetectionCriterion(Schema):
    """The difference must lie above a bound."""

    measure: str
    signal: str
    lower_above: float


class Reported(Schema):
    """A measure whose difference is reported with its interval and not tested."""

    measure: str
    signal: str


class EquivalenceCriterion(Schema):
    """The baseline's ``signal`` must equal the arm's signal ``against`` within a margin (TOST)."""

    measure: str
    signal: str
    against: str
    equivalence: float


class Rivals(Schema):
    """Thresholds that need no coordination, tried on the baseline."""

    thresholds: list[str]


class Criteria(Schema):
    """Two primary criteria and four secondary ones."""

    P1: FalseAlarmCriterion
    P2: DetectionCriterion
    S1: Reported
    S2: EquivalenceCriterion
    S3: Rivals
    S4: Reported


class LowerBound(Schema):
    """A difference must lie above a bound."""

    measure: str
    lower_above: float


class UpperBound(Schema):
    """A difference must lie below a bound."""

    measure: str
    upper_below: float


class DistributionRival(Schema):
    """The baseline's ``signal`` must detect no worse than the arm's ``against``, and with a smaller gap."""

    signal: str
    against: str
    detection: LowerBound
    false_alarms: UpperBound


class LaterCriteria(Schema):
    """What was registered after the first environment's results, for the environments not scored by then."""

    environments: list[EnvName]
    S5: DistributionRival


class ResampledArms(Schema):
    """Arms that train nothing, and the names of those whose P1 and P2 are claims, apart from the protocol's own."""

    arms: list[ResampledRow]
    claims: list[str]


class Registration(Schema):
    """The protocol; ``docs/monitor_registration.md`` says in words what each field is for."""

    format: Literal["dualhead-monitor-registration/1"]
    question: str
    environments: dict[EnvName, Environment]
    arms: dict[str, PolicyFields]
    baseline: str
    primary_arm: str
    executor: Executor
    presets: dict[Literal["full", "smoke"], Budget]
    log: Log
    scoring: Scoring
    inference: Inference
    gate: Gate
    criteria: Criteria

    @model_validator(mode="after")
    def _consistent(self) -> Registration:
        for name in (self.baseline, self.primary_arm):
            if name not in self.arms:
                raise ValueError(f"names the arm {name!r}, expected one of {sorted(self.arms)}")
        if any(self.executor.seed in budget.seeds for budget in self.presets.values()):
            raise ValueError(f"trains the executor with the seed {self.executor.seed} of an arm, expected another one")
        return self


def registered() -> Registration:
    """The protocol that comes with this package."""
    return _packaged(SOURCE, Registration)


def registered_later() -> LaterCriteria:
    """What was added to the protocol later; a file of its own, so that the protocol stays what it was."""
    return _packaged(LATER_SOURCE, LaterCriteria)


def registered_resampled() -> ResampledArms:
    """The arms that were added later and train nothing."""
    return _packaged(RESAMPLED_SOURCE, ResampledArms)


def _packaged[S: Schema](name: str, schema: type[S]) -> S:
    text = files(__package__).joinpath(name).read_text(encoding="utf-8")
    return validated(yaml.safe_load(text), schema, source=name, remedy="install the package again")
