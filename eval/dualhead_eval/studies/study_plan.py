"""The runs that a study needs and the evaluations of their checkpoints, as plain lists.

A run is its dataset, configuration, budget and seed, and its name says so. Studies that need the same run share it,
and share the gate files of its checkpoints:

    DATASET/CONFIGURATION-BUDGET/seed-S/STEP-BANK.gate.json.gz
    v2/G_consistency_3-50k/seed-0/050000-frozen.gate.json.gz
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from dualhead_eval.studies.smoke_study import smoke_study
from dualhead_eval.studies.study_file import Bank, RunBlock, StudyDataset, StudyFile
from dualhead_policy.sampling import SamplingCoupling
from dualhead_policy.training.sweep.sweep_file import FlagValue, SweepRun, command_flags, named

#: How a study's gate files end.
GATE_SUFFIX = ".gate.json.gz"
#: How the outcomes of its closed loops end.
LOOP_SUFFIX = ".rollouts.json.gz"
#: Sampling as the policy was trained.
POLICYS_OWN = SamplingCoupling()


@dataclass(frozen=True)
class StudyRun:
    """One run of a study: a training, or another row's checkpoints sampled otherwise.

    Attributes:
        dataset: Name of its dataset.
        configuration: Name of its row.
        config: Configuration file, or None.
        flags: Flags of its own, without dashes, the study's among them.
        seed: Training seed.
        steps: Training budget.
        checkpoints: Steps whose checkpoints are wanted, increasing.
        importance: The most important block that needs it, 1 being the first.
        trained_as: Name of the configuration whose training it is, where that is another row's.
        coupling: What the heads share in sampling, the policy's own way by default.
        draws: The head of which two independent draws are a pair; None where the pair is the two heads.
    """

    dataset: str
    configuration: str
    config: str | None
    flags: Mapping[str, FlagValue]
    seed: int
    steps: int
    checkpoints: tuple[int, ...]
    importance: int
    trained_as: str | None = None
    coupling: SamplingCoupling = POLICYS_OWN
    draws: Literal["joint", "position"] | None = None

    @property
    def cell(self) -> str:
        """The run without its seed: ``DATASET/CONFIGURATION-BUDGET``."""
        return f"{self.dataset}/{self.configuration}-{shown_budget(self.steps)}"

    @property
    def name(self) -> str:
        """``DATASET/CONFIGURATION-BUDGET/seed-S``: the folder of its gate files."""
        return f"{self.cell}/seed-{self.seed}"

    @property
    def training_name(self) -> str:
        """Name of its training in a sweep, in the form of :attr:`name`; rows that share a training share it."""
        trained = self.trained_as or self.configuration
        return f"{self.dataset}/{trained}-{shown_budget(self.steps)}/seed-{self.seed}"

    @property
    def training(self) -> tuple[object, ...]:
        """What its training is, apart from its dataset: runs of one name that differ in it are two trainings."""
        return self.config, dict(self.flags), self.seed, self.steps

    def sweep_run(self, data: Path) -> SweepRun:
        """The run as a sweep trains it, on the datasets below ``data``."""
        root = data / self.dataset / "train"
        arguments = (
            *([f"--config_path={Path(self.config).resolve()}"] if self.config else []),
            f"--dataset.root={root.resolve()}",
            f"--seed={self.seed}",
            *command_flags(self.flags),
            f"--steps={self.steps}",
            f"--save_freq={self.steps}",
        )
        return SweepRun(self.training_name, str(root), self.seed, arguments, save_at=self.checkpoints)


@dataclass(frozen=True)
class StudyEvaluation:
    """One evaluation of a study: a checkpoint under a bank.

    Attributes:
        run: The run.
        step: The checkpoint.
        bank: Name of the bank.
        importance: As of the run, of this evaluation.
    """

    run: StudyRun
    step: int
    bank: str
    importance: int

    @property
    def gate_file(self) -> Path:
        """Its gate file below the folder of gate files."""
        return Path(self.run.name) / f"{self.step:06d}-{self.bank}{GATE_SUFFIX}"

    @property
    def label(self) -> str:
        """Its name in tables: configuration, budget, dataset and seed, and the step where it is not the last."""
        at = "" if self.step == self.run.steps else f" at {shown_budget(self.step)}"
        return f"{self.run.cell} seed {self.run.seed}{at}"


@dataclass(frozen=True)
class StudyLoop:
    """One closed loop of a study: the end of a run, driven by one head.

    Attributes:
        run: The run.
        control: The head that drives: ``"joint"``, ``"position"`` or ``"pose"``.
        episodes: Episodes.
        first_seed: Seed of the first.
        importance: As of the run, of this closed loop.
    """

    run: StudyRun
    control: str
    episodes: int
    first_seed: int
    importance: int

    @property
    def file(self) -> Path:
        """The file of its outcomes below the folder of closed loops."""
        return Path(self.run.name) / f"{self.run.steps:06d}-{self.control}{LOOP_SUFFIX}"


@dataclass(frozen=True)
class StudyPlan:
    """What one study, or several, need.

    Attributes:
        datasets: Demonstrations by name.
        banks: Evaluation banks by (dataset, bank).
        runs: Runs, the most important first.
        evaluations: Evaluations of their checkpoints, the most important first.
        loops: Closed loops of their ends, the most important first.
    """

    datasets: dict[str, StudyDataset] = field(default_factory=dict)
    banks: dict[tuple[str, str], Bank] = field(default_factory=dict)
    runs: tuple[StudyRun, ...] = ()
    evaluations: tuple[StudyEvaluation, ...] = ()
    loops: tuple[StudyLoop, ...] = ()

    def bank(self, evaluation: StudyEvaluation) -> Bank:
        """The bank of an evaluation."""
        return self.banks[evaluation.run.dataset, evaluation.bank]

    def trainings(self, wanted: Iterable[StudyRun]) -> list[StudyRun]:
        """The runs that train what some runs need, each once, in their order."""
        by_name = {run.name: run for run in self.runs}
        return [by_name[name] for name in dict.fromkeys(run.training_name for run in wanted)]


def plan_study(study: StudyFile, *, smoke: bool = False, later: bool = False) -> StudyPlan:
    """The runs and evaluations of a study.

    Args:
        study: The study.
        smoke: In its smallest form.
        later: With the blocks that are marked ``later``.

    Raises:
        ValueError: If two of its runs have one name and differ, or no block is important enough for its smoke form.
    """
    if smoke:
        study = smoke_study(study)
    plans = [_plan_block(study, block) for block in study.runs if later or not block.later]
    return join_plans(plans)


def join_plans(plans: Sequence[StudyPlan]) -> StudyPlan:
    """What several studies need together; what they share is there once, at its highest importance.

    Raises:
        ValueError: If two of them mean different things by one name.
    """
    datasets: dict[str, StudyDataset] = {}
    banks: dict[tuple[str, str], Bank] = {}
    runs: dict[str, StudyRun] = {}
    evaluations: dict[Path, StudyEvaluation] = {}
    loops: dict[Path, StudyLoop] = {}
    for plan in plans:
        for name, dataset in plan.datasets.items():
            _same("dataset", name, datasets.setdefault(name, dataset), dataset)
        for key, bank in plan.banks.items():
            _same("bank", "/".join(key), banks.setdefault(key, bank), bank)
        for run in plan.runs:
            known = runs.get(run.name, run)
            _same("run", run.name, _identity(known), _identity(run))
            checkpoints = tuple(sorted({*known.checkpoints, *run.checkpoints}))
            importance = min(known.importance, run.importance)
            runs[run.name] = replace(known, checkpoints=checkpoints, importance=importance)
        for evaluation in plan.evaluations:
            other = evaluations.get(evaluation.gate_file, evaluation)
            importance = min(other.importance, evaluation.importance)
            evaluations[evaluation.gate_file] = replace(evaluation, importance=importance)
        for loop in plan.loops:
            before = loops.get(loop.file, loop)
            episodes, others = ((one.first_seed, one.episodes) for one in (before, loop))
            _same("closed loop", str(loop.file), episodes, others)
            loops[loop.file] = replace(loop, importance=min(before.importance, loop.importance))
    found = [replace(evaluation, run=runs[evaluation.run.name]) for evaluation in evaluations.values()]
    driven = [replace(loop, run=runs[loop.run.name]) for loop in loops.values()]
    return StudyPlan(
        datasets,
        banks,
        tuple(sorted(runs.values(), key=lambda run: run.importance)),
        tuple(sorted(found, key=lambda evaluation: evaluation.importance)),
        tuple(sorted(driven, key=lambda loop: loop.importance)),
    )


def shown_budget(steps: int) -> str:
    """A budget as names have it.

    >>> shown_budget(50_000), shown_budget(600)
    ('50k', '600')
    """
    return f"{steps // 1000}k" if steps % 1000 == 0 else str(steps)


def _plan_block(study: StudyFile, block: RunBlock) -> StudyPlan:
    datasets = {name: study.datasets[name] for name in block.datasets or study.datasets}
    banks = {name: study.banks[name] for name in block.banks or list(study.banks)[:1]}
    runs, evaluations, loops = [], [], []
    configurations = [named(configuration) for configuration in block.configurations]
    for configuration, dataset, steps, seed in itertools.product(configurations, datasets, block.budgets, block.seeds):
        points = tuple(sorted(block.evaluate_at or [steps]))
        trained = StudyRun(
            dataset=dataset,
            configuration=configuration.name,
            config=configuration.config,
            flags=study.flags | configuration.flags,
            seed=seed,
            steps=steps,
            checkpoints=points,
            importance=block.importance,
        )
        resampled = [
            replace(
                trained,
                configuration=row.name,
                trained_as=configuration.name,
                coupling=row.coupling,
                draws=row.draws,
            )
            for row in block.resampled
            if row.of == configuration.name
        ]
        for run in (trained, *resampled):
            runs.append(run)
            evaluations += [
                StudyEvaluation(run, step, bank, block.importance) for step, bank in itertools.product(points, banks)
            ]
        loops += _plan_loops(block, trained)
    keyed = {(dataset, name): bank for dataset in datasets for name, bank in banks.items()}
    return StudyPlan(datasets, keyed, tuple(runs), tuple(evaluations), tuple(loops))


def _plan_loops(block: RunBlock, run: StudyRun) -> list[StudyLoop]:
    """The closed loops that a block asks of a run."""
    asked = block.closed_loops
    if asked is None or run.configuration not in asked.rows or run.seed not in (asked.seeds or block.seeds[:1]):
        return []
    return [StudyLoop(run, control, asked.episodes, asked.first_seed, block.importance) for control in asked.controls]


def _identity(run: StudyRun) -> tuple[object, ...]:
    return run.training, run.trained_as, run.coupling, run.draws


def _same(what: str, name: str, first: object, second: object) -> None:
    if first != second:
        raise ValueError(
            f"the {what} {name} is given twice and differs ({first} and {second}): give one of them another name"
        )
