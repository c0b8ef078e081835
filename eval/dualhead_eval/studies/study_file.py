"""``studies/NAME.yaml``: what a study trains, evaluates and asks, and by which criteria it will be judged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from dualhead_envs.validated_json import Label, Schema
from dualhead_envs.validated_yaml import read_validated_yaml
from dualhead_eval.evaluation.protocol import FROZEN_NFE, FROZEN_PAIRS
from dualhead_eval.studies.criterion import Criterion
from dualhead_policy.sampling import SamplingCoupling
from dualhead_policy.training.sweep.sweep_file import FlagValue, Name, NamedConfiguration, named

REMEDY = "see docs/studies.md for the fields of a study"

#: What a study's picture shows.
Figure = Literal["rho", "capacity", "steps"]

Steps = Annotated[int, Field(ge=1, le=10**8)]
Count = Annotated[int, Field(ge=1, le=10**7)]
Seed = Annotated[int, Field(ge=0, le=2**32 - 1)]


class StudyDataset(Schema):
    """Demonstrations, as ``dualhead record`` would make them.

    Attributes:
        env: Environment id.
        env_kwargs: Its keyword arguments.
        episodes: Ring: paths in train.
        pairs: Robots: initial states in all splits, each shown in both modes.
        conditions: Ring: conditions in val and test.
        seed, bank_seed: Seeds of the demonstrations, and of the ring's val and test.
    """

    env: Label
    env_kwargs: dict[str, Any] = Field(default_factory=dict)
    episodes: Count | None = None
    pairs: Count | None = None
    conditions: Count | None = None
    seed: Seed = 0
    bank_seed: Seed | None = None


class Bank(Schema):
    """Conditions and protocol of one evaluation; the defaults are the frozen protocol.

    Attributes:
        conditions: The first so many of the test split; None: all.
        pairs: Sample pairs per condition.
        nfes: Numbers of Euler steps, the reference first.
        taus: Thresholds beside the partition's own.
        seed: Seed of the draws.
        residuals: Whether gates of finished runs keep the residuals between the heads; gates on the way never do.
    """

    conditions: Count | None = None
    pairs: Count = FROZEN_PAIRS
    nfes: list[Annotated[int, Field(ge=1, le=10_000)]] = Field(default=[FROZEN_NFE], min_length=1)
    taus: list[Annotated[float, Field(gt=0)]] = Field(default_factory=list)
    seed: Seed = 0
    residuals: bool = True


class ResampledRow(Schema):
    """A row that trains nothing: another row's checkpoints, sampled otherwise.

    Heads whose losses are separate learn the same velocity fields under every coupling of the noise, and any heads
    under every draw of the token, whose learned prior sends them no gradient: a question to the sampler alone.
    Two independent draws of one head are coordinated by nothing, whatever couples the heads.

    Attributes:
        name: The row.
        of: The configuration whose checkpoints are sampled.
        source_noise_beta: Coupling of the heads' source noise in sampling, 1 private to 0 shared; None: as trained.
        source_noise_alignment: Shared noise goes through the kinematic map; None: coordinate by coordinate.
        token_draw: Distribution of the tokens in sampling; None: as trained.
        draws: The head of which two independent draws are a pair; None: the pair is the two heads.
    """

    name: Name
    of: Name
    source_noise_beta: Annotated[float, Field(ge=0, le=1)] | None = None
    source_noise_alignment: Literal["kinematic"] | None = None
    token_draw: Literal["uniform", "marginal", "learned"] | None = None
    draws: Literal["joint", "position"] | None = None

    @model_validator(mode="after")
    def _samples_otherwise(self) -> Self:
        coupled = self.coupling != SamplingCoupling()
        if not coupled and self.draws is None:
            raise ValueError(
                f"its resampled row {self.name!r} samples as {self.of!r} does: give source_noise_beta, "
                "source_noise_alignment, token_draw or draws"
            )
        if coupled and self.draws is not None:
            raise ValueError(
                f"its resampled row {self.name!r} couples heads and pairs draws of one: give draws alone, or none"
            )
        return self

    @property
    def coupling(self) -> SamplingCoupling:
        """How the checkpoints are sampled."""
        return SamplingCoupling(
            source_noise_beta=self.source_noise_beta,
            source_noise_alignment=self.source_noise_alignment,
            token_draw=self.token_draw,
        )


class ClosedLoops(Schema):
    """Rows of a block that also drive the robot, at the end of their runs.

    Attributes:
        rows: Configurations of the block.
        seeds: Training seeds of the block; None: its first.
        controls: Heads that drive, each in episodes of its own.
        episodes: Episodes of each, from initial states that no demonstration began from.
        first_seed: Seed of the first episode; the next has the next.
    """

    rows: list[Name] = Field(min_length=1)
    seeds: list[Seed] | None = None
    controls: list[Literal["joint", "position", "pose"]] = Field(min_length=1)
    episodes: Count
    first_seed: Seed = 0


class RunBlock(Schema):
    """Configurations x datasets x seeds x budgets, and where their checkpoints are evaluated.

    Attributes:
        importance: 1 for what a claim rests on; a short budget is spent on small numbers first.
        configurations: Files of ``dualhead train --config_path``, or named rows with flags of their own.
        resampled: Further rows, evaluated from the checkpoints of these configurations.
        datasets: Names of the study's datasets; None: all.
        seeds: Training seeds.
        steps: Training budgets; each is a run of its own.
        evaluate_at: Steps whose checkpoints are evaluated, at most the budget; None: the end.
        banks: Names of the study's banks; None: its first.
        closed_loops: Which of them also drive the robot; None: none.
        later: Left out of what the study needs to be finished, unless asked for.
    """

    importance: Annotated[int, Field(ge=1, le=9)]
    configurations: list[str | NamedConfiguration] = Field(min_length=1)
    resampled: list[ResampledRow] = Field(default_factory=list)
    datasets: list[Name] | None = None
    seeds: list[Seed] = Field(min_length=1)
    steps: Steps | list[Steps]
    evaluate_at: list[Steps] | None = None
    banks: list[Name] | None = None
    closed_loops: ClosedLoops | None = None
    later: bool = False

    @property
    def budgets(self) -> list[int]:
        """Training budgets, as a list."""
        return list(self.steps) if isinstance(self.steps, list) else [self.steps]

    @property
    def rows(self) -> list[str]:
        """Names of its rows, the trained ones first."""
        return [named(configuration).name for configuration in self.configurations] + [
            row.name for row in self.resampled
        ]

    @model_validator(mode="after")
    def _evaluates_what_it_trains(self) -> Self:
        trained = [named(configuration).name for configuration in self.configurations]
        for row in self.resampled:
            if row.of not in trained or row.name in trained:
                raise ValueError(
                    f"its resampled row {row.name!r} needs a name of its own and is of {row.of!r}, expected one of "
                    f"the block's configurations ({', '.join(trained)})"
                )
        if (loops := self.closed_loops) is not None:
            _refuse_unknown("row", loops.rows, trained, "closed_loops: ")
            _refuse_unknown("seed", loops.seeds or (), self.seeds, "closed_loops: ")
        late = [step for step in self.evaluate_at or () if step > min(self.budgets)]
        if late:
            raise ValueError(f"evaluates at step {late[0]}, beyond its budget of {min(self.budgets)} steps")
        return self


class SmokeBudget(Schema):
    """What ``--preset smoke`` makes of a study.

    Attributes:
        importance: Blocks up to this importance are run.
        seeds: The first so many of each block.
        steps: Training budget in place of the study's largest; smaller ones and checkpoints shrink alike.
        conditions, pairs: Conditions, and pairs per condition, of every bank.
        episodes, demonstration_pairs: Size of ring and robot datasets.
        closed_loop_episodes: Episodes of every closed loop.
    """

    importance: Annotated[int, Field(ge=1, le=9)] = 1
    seeds: Count = 1
    steps: Steps = 600
    conditions: Count = 6
    pairs: Count = 64
    episodes: Count = 2000
    demonstration_pairs: Count = 24
    closed_loop_episodes: Count = 2


class StudyFile(Schema):
    """The content of a study file.

    Attributes:
        title, question: What the study is called and asks.
        paper: Tables and sections of the paper that it re-runs.
        datasets: Demonstrations by name.
        banks: Evaluations by name; the first is the default of every block.
        flags: Flags of ``dualhead train`` for every run, without dashes.
        runs: What is trained and evaluated.
        criteria: By which its claims are judged.
        smoke: Its smallest form.
        figure: What its picture shows: rho of every cell at the end of its runs, C relative to its maximum instead, or
            rho over steps of the rows with three checkpoints or budgets and more.
    """

    title: Label
    question: str
    paper: list[str] = Field(default_factory=list)
    datasets: dict[Name, StudyDataset] = Field(min_length=1)
    banks: dict[Name, Bank] = Field(min_length=1)
    flags: dict[str, FlagValue] = Field(default_factory=dict)
    runs: list[RunBlock] = Field(min_length=1)
    criteria: list[Criterion] = Field(min_length=1)
    smoke: SmokeBudget = Field(default_factory=SmokeBudget)
    figure: Figure = "rho"

    @model_validator(mode="after")
    def _names_what_it_has(self) -> Self:
        for block in self.runs:
            _refuse_unknown("dataset", block.datasets or (), self.datasets)
            _refuse_unknown("bank", block.banks or (), self.banks)
        rows = {row for block in self.runs for row in block.rows}
        for criterion in self.criteria:
            _refuse_unknown("row", criterion.all_rows, rows, f"criterion {criterion.name}: ")
            _refuse_unknown("dataset", criterion.all_datasets, self.datasets, f"criterion {criterion.name}: ")
            _refuse_unknown("bank", criterion.all_banks, self.banks, f"criterion {criterion.name}: ")
        names = [criterion.name for criterion in self.criteria]
        if len(set(names)) < len(names):
            raise ValueError("has two criteria of one name")
        return self


def read_study(path: Path) -> StudyFile:
    """Read a study file.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is not YAML, or does not fit :class:`StudyFile`.
    """
    return read_validated_yaml(path, StudyFile, what="a study", remedy=REMEDY)


def _refuse_unknown(what: str, given: Any, known: Any, where: str = "") -> None:
    for name in given:
        if name not in known:
            raise ValueError(f"{where}names the {what} {name!r}, which is not among its own")
