"""The monitor study in one folder: demonstrations, policies, log, scores; each stage is skipped where it is done."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dualhead_envs.dataset_frames import read_split
from dualhead_envs.validated_json import read_json
from dualhead_eval.atomic_text import write_text
from dualhead_eval.evaluation.conditions import recorded_environment
from dualhead_eval.monitor.branch_flag import BranchFlag
from dualhead_eval.report.monitor_page import monitor_page
from dualhead_eval.report.table import Table
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.conclusions import Conclusions
from dualhead_eval.studies.monitor.figures import STUDY_CAPTIONS, study_figures
from dualhead_eval.studies.monitor.log_table import MonitorLog, collect_log, read_log, write_log
from dualhead_eval.studies.monitor.observation_scores import OBSERVING, score_observations
from dualhead_eval.studies.monitor.recording import parts, record_log
from dualhead_eval.studies.monitor.registration import (
    EnvName,
    LaterCriteria,
    PolicyFields,
    Registration,
    registered_later,
    registered_resampled,
)
from dualhead_eval.studies.monitor.score_files import ScoreJob, score_files
from dualhead_policy.pretrained import policy_folder

SETTINGS, LOG, SCORES = "study.json", "log.parquet", "scores"
EXECUTOR = "executor"


class MonitorStudy:
    """One study in one folder.

    Args:
        protocol: The registered protocol.
        env: Name of its environment.
        preset: Name of its budget.
        root: Folder of the study.
        data: Demonstrations of ``dualhead record``, instead of recording them.
        arms: Folder of trained arms, ``ARM/seed-S``, instead of training them; those that are missing are left out.
        executor: A trained executor.
        jobs: Processes at a time.
        device: Where arms are sampled.
    """

    def __init__(
        self,
        protocol: Registration,
        env: EnvName,
        preset: str,
        root: Path,
        *,
        data: Path | None = None,
        arms: Path | None = None,
        executor: Path | None = None,
        jobs: int = 2,
        device: str = "cpu",
    ) -> None:
        self.protocol, self.env, self.preset, self.root = protocol, env, preset, root
        self.budget = protocol.presets["full" if preset == "full" else "smoke"]
        self.data = data or root / "data"
        self.given_arms, self.given_executor = arms, executor
        self.jobs, self.device = jobs, device
        self.resampled = {arm.name: arm for arm in registered_resampled().arms}
        self.console = Console(stderr=True)

    @property
    def later(self) -> LaterCriteria | None:
        """What was registered later for its environment."""
        later = registered_later()
        return later if self.env in later.environments else None

    def claim_folder(self) -> None:
        """Create the folder, or go on in it.

        Raises:
            FileExistsError: If it holds something else, or a study with other settings.
        """
        path = self.root / SETTINGS
        if path.is_file():
            if not self.is_claimed():
                raise FileExistsError(
                    f"{self.root} holds a monitor study of another environment, preset or protocol: give another "
                    "--output"
                )
            return
        if self.root.exists() and any(self.root.iterdir()):
            raise FileExistsError(f"{self.root} is not empty and holds no monitor study: give another --output")
        write_text(path, json.dumps(self._settings(), indent=1))

    def is_claimed(self) -> bool:
        """Whether its folder is there and holds this environment, preset and protocol."""
        path = self.root / SETTINGS
        if not path.is_file():
            return False
        return read_json(path, kind="the settings of a monitor study", remedy="give another folder") == self._settings()

    def _settings(self) -> dict[str, Any]:
        return {"env": self.env, "preset": self.preset, "protocol": self.protocol.model_dump(mode="json")}

    def record_demonstrations(self) -> None:
        """Record the demonstrations, unless they are there."""
        from dualhead_envs.record import record

        if (self.data / "card.json").is_file() or (self.root / LOG).is_file():
            return
        environment = self.protocol.environments[self.env]
        pairs = environment.pairs if self.preset == "full" else environment.smoke_pairs
        record(environment.env_id, self.data, seed=0, progress=True, pairs=pairs)

    def train(self) -> None:
        """Train the executor and the arms that are neither given nor finished, runs of equal shapes as one program."""
        from dualhead_policy.training.sweep.run_sweep import run_sweep
        from dualhead_policy.training.sweep.sweep_file import SweepRun

        executor = self.protocol.executor
        wanted: list[tuple[str, int, PolicyFields]] = []
        if self.given_executor is None and not (self.root / LOG).is_file():
            wanted.append((EXECUTOR, executor.seed, executor.policy))
        if self.given_arms is None:
            wanted += [
                (arm, seed, fields)
                for arm, fields in self.protocol.arms.items()
                for seed in self.budget.seeds
                if not all(self.scores_file(name, seed).is_file() for name in self._scored_with(arm))
            ]
        root = (self.data / "train").resolve()
        runs = [
            SweepRun(
                f"{name}/seed-{seed}",
                str(root),
                seed,
                (
                    f"--dataset.root={root}",
                    f"--seed={seed}",
                    f"--steps={self.budget.steps}",
                    f"--save_freq={self.budget.steps}",
                    "--policy.device=cpu",
                    *(f"--policy.{field}={value}" for field, value in fields.items()),
                ),
                "smoke",
            )
            for name, seed, fields in wanted
        ]
        if runs:
            manifest = run_sweep(runs, self.root / "policies", jobs=self.jobs, size=16, precision="fp32")
            failed = {name: record.error for name, record in manifest.runs.items() if record.state == "failed"}
            if failed:
                name, error = next(iter(failed.items()))
                raise ValueError(f"training of {name} failed ({error}): repeat the command to try again")

    @property
    def executor(self) -> Path:
        """Folder of the policy that drives."""
        return self.given_executor or self.root / "policies" / EXECUTOR / f"seed-{self.protocol.executor.seed}"

    def arm(self, name: str, seed: int) -> Path:
        """Folder of an arm's policy."""
        return (self.given_arms or self.root / "policies") / name / f"seed-{seed}"

    def log(self) -> MonitorLog:
        """Record the log, or read it if it is there."""
        if (self.root / LOG).is_file():
            return read_log(self.root / LOG)
        split = read_split(self.data / "train")
        _, env_kwargs = recorded_environment(split)
        total = sum(part.episodes for part in parts(self.protocol, self.budget))
        with self._bar("recording the log", total, "episodes") as advance:
            record_log(
                self.root / "log", self.executor, self.env, self.protocol, self.budget,
                env_kwargs=env_kwargs, jobs=self.jobs, progress=advance,
            )  # fmt: skip
        with self._bar("flagging decisions", total, "episodes") as advance:
            log = collect_log(
                self.root / "log", self.protocol, self.budget, BranchFlag.from_split(split), progress=advance
            )
        write_log(log, self.root / LOG)
        return log

    def _scored_with(self, arm: str) -> list[str]:
        """The arms that are scored with the policies of a trained one: itself, and those that sample it otherwise."""
        return [arm, *(name for name, resampled in self.resampled.items() if resampled.of == arm)]

    def scores_file(self, arm: str, seed: int) -> Path:
        """Where the scores of an arm are kept."""
        return self.root / SCORES / f"{arm}-{seed}.parquet"

    def missing(self) -> list[ScoreJob]:
        """What can be scored and is not: the baseline and the primary arm first, arms that train nothing last."""
        first = [self.protocol.baseline, self.protocol.primary_arm]
        others = [arm for arm in self.protocol.arms if arm not in first]
        jobs = []
        for arms in (first, others, list(self.resampled)):
            for seed in self.budget.seeds:
                for arm in arms:
                    resampled = self.resampled.get(arm)
                    policy = self.arm(arm if resampled is None else resampled.of, seed)
                    coupling = None if resampled is None else resampled.coupling
                    jobs.append(ScoreJob(policy, self.scores_file(arm, seed), seed, coupling))
        return [job for job in jobs if not job.target.is_file() and _has_policy(job.policy)]

    def score(self, log: MonitorLog) -> None:
        """Score every arm that is there and not scored yet, several at a time."""
        todo = self.missing()
        with self._bar("scoring arms", len(todo), "runs") as advance:
            score_files(
                self.root / LOG, todo, self.protocol.scoring, workers=self.jobs, device=self.device, progress=advance
            )

    def score_observations(self, log: MonitorLog) -> None:
        """Score what the observations alone say, unless it is there; without demonstrations it is left out."""
        path = self.root / SCORES / f"{OBSERVING}.parquet"
        if not path.is_file() and (self.data / "train").is_dir():
            score_observations(log, self.data / "train", self.protocol.scoring.seed).write(path)

    def observed(self) -> ArmScores | None:
        """What the observations alone say, if it was scored."""
        path = self.root / SCORES / f"{OBSERVING}.parquet"
        return ArmScores.read(path) if path.is_file() else None

    def scored(self) -> dict[str, dict[int, ArmScores]]:
        """The scores of every arm that has some, by training seed."""
        found: dict[str, dict[int, ArmScores]] = {}
        for arm in [*self.protocol.arms, *self.resampled]:
            for seed in self.budget.seeds:
                if self.scores_file(arm, seed).is_file():
                    found.setdefault(arm, {})[seed] = ArmScores.read(self.scores_file(arm, seed))
        return found

    def keep(self, folder: Path, log: MonitorLog) -> None:
        """Write what the verdicts and further arms need into another folder: the log, the criteria's signals.

        The first seeds of the baseline and the primary arm keep all their signals, which the paper's tables hold.

        Raises:
            FileExistsError: If the folder holds anything.
        """
        if folder.exists() and any(folder.iterdir()):
            raise FileExistsError(f"{folder} is not empty: give another --keep, or delete it first")
        criteria = self.protocol.criteria
        signals = {criteria.P1.signal, criteria.P2.signal, criteria.S2.signal, criteria.S2.against}
        if self.later is not None:
            signals |= {self.later.S5.signal, self.later.S5.against}
        for arm, by_seed in self.scored().items():
            for seed, scores in by_seed.items():
                whole = seed == min(by_seed) and arm in (self.protocol.baseline, self.protocol.primary_arm)
                kept = scores if whole else scores.only(list(signals))
                kept.write(folder / SCORES / f"{arm}-{seed}.parquet")
        observed = self.observed()
        if observed is not None:
            observed.write(folder / SCORES / f"{OBSERVING}.parquet")
        write_log(log, folder / LOG)
        write_text(folder / SETTINGS, (self.root / SETTINGS).read_text())

    def write_page(self, tables: list[Table], found: Conclusions) -> Path:
        """Write tables and figures as one HTML page; returns its path."""
        path = self.root / "report.html"
        write_text(path, monitor_page(tables, study_figures(found), STUDY_CAPTIONS))
        return path

    def _bar(self, title: str, total: int, unit: str) -> Any:
        return _Bar(self.console, title, total, unit)


class _Bar:
    """A progress bar with the time left, as a context that gives the function that advances it."""

    def __init__(self, console: Console, title: str, total: int, unit: str) -> None:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(unit),
            TimeRemainingColumn(),
        )
        self._progress = Progress(*columns, console=console)
        self._task = self._progress.add_task(title, total=total)

    def __enter__(self) -> Callable[[int], object]:
        self._progress.start()
        return lambda done: self._progress.advance(self._task, done)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _has_policy(folder: Path) -> bool:
    try:
        policy_folder(folder)
    except FileNotFoundError:
        return False
    return True
