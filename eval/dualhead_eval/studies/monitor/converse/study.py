"""The converse in one folder: demonstrations, policies, scored runs; each stage is skipped where it is done."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dualhead_envs.dataset_frames import read_split
from dualhead_envs.validated_json import read_json
from dualhead_eval.atomic_text import write_text
from dualhead_eval.studies.monitor.converse.protocol import ArmName, ConverseProtocol, Preset, Run
from dualhead_eval.studies.monitor.converse.tally import RunTally, read_tally

SETTINGS, RUNS = "converse.json", "runs"
#: Runs that are trained as one program at most.
STACK = 16


class ConverseStudy:
    """One study in one folder.

    Args:
        protocol: The registered protocol.
        preset: Name of its budget.
        root: Folder of the study.
        jobs: Processes at a time.
        wanted: Makes only these runs, side step in mm, arm and training seed; all of the protocol's by default.
    """

    def __init__(
        self,
        protocol: ConverseProtocol,
        preset: Preset,
        root: Path,
        *,
        jobs: int = 1,
        wanted: Sequence[Run] | None = None,
    ) -> None:
        self.protocol, self.preset, self.budget = protocol, preset, protocol.presets[preset]
        self.root, self.jobs = root, jobs
        self.wanted = self.budget.runs() if wanted is None else wanted
        self.console = Console(stderr=True)

    def claim_folder(self) -> None:
        """Create the folder, or go on in it.

        Raises:
            FileExistsError: If it holds something else, or a study of another protocol.
        """
        settings = {"preset": self.preset, "protocol": self.protocol.model_dump(mode="json")}
        path = self.root / SETTINGS
        if path.is_file():
            if read_json(path, kind="the settings of a converse", remedy="give another --output") != settings:
                raise FileExistsError(
                    f"{self.root} holds a converse of another preset or protocol: give another --output"
                )
            return
        if self.root.exists() and any(self.root.iterdir()):
            raise FileExistsError(f"{self.root} is not empty and holds no converse: give another --output")
        write_text(path, json.dumps(settings, indent=1))

    def data(self, amplitude_mm: int) -> Path:
        """Folder of the demonstrations of a side step."""
        return self.root / "data" / f"{amplitude_mm:03d}mm"

    def policy(self, amplitude_mm: int, arm: ArmName, seed: int) -> Path:
        """Folder of a policy."""
        return self.root / "policies" / self.data(amplitude_mm).name / arm / f"seed-{seed}"

    def run_file(self, amplitude_mm: int, arm: ArmName, seed: int) -> Path:
        """Where a scored run is kept."""
        return self.root / RUNS / f"{self.data(amplitude_mm).name}-{arm}-{seed}.json"

    def missing(self) -> list[Run]:
        """The wanted runs that are not scored."""
        return [run for run in self.wanted if not self.run_file(*run).is_file()]

    def record(self) -> None:
        """Record the demonstrations that missing runs need and that are not there."""
        from dualhead_envs.record import record

        protocol = self.protocol
        for amplitude in sorted({amplitude for amplitude, _, _ in self.missing()}):
            root = self.data(amplitude)
            if (root / "card.json").is_file():
                continue
            settings = {"obstacle": protocol.obstacle, "amplitude": amplitude / 1000}
            record(
                protocol.env_id, root, seed=protocol.record_seed, env_kwargs=settings, progress=True,
                pairs=self.budget.pairs, workers=self.jobs,
            )  # fmt: skip

    def train(self) -> None:
        """Train the policies of missing runs, runs of equal shapes as one program.

        Raises:
            ValueError: If a training failed.
        """
        from dualhead_policy.training.sweep.run_sweep import run_sweep
        from dualhead_policy.training.sweep.sweep_file import SweepRun

        policies, runs = self.root / "policies", []
        for amplitude, arm, seed in self.missing():
            root = str((self.data(amplitude) / "train").resolve())
            flags = {
                "dataset.root": root, "seed": seed, "steps": self.budget.steps, "save_freq": self.budget.steps,
                "policy.device": "cpu",
                **{f"policy.{field}": value for field, value in self.protocol.arms[arm].items()},
            }  # fmt: skip
            name = self.policy(amplitude, arm, seed).relative_to(policies).as_posix()
            runs.append(SweepRun(name, root, seed, tuple(f"--{k}={v}" for k, v in flags.items()), "smoke"))
        if runs:
            manifest = run_sweep(runs, policies, jobs=self.jobs, size=STACK, precision="fp32")
            failed = {name: record.error for name, record in manifest.runs.items() if record.state == "failed"}
            if failed:
                name, error = next(iter(failed.items()))
                raise ValueError(f"training of {name} failed ({error}): repeat the command to try again")

    def score(self) -> None:
        """Score every run that is not scored, one after the other."""
        import torch

        from dualhead_eval.studies.monitor.converse.scoring import score_run
        from dualhead_policy.pretrained import load_policy, policy_folder
        from dualhead_policy.quiet import quiet_libraries
        from dualhead_policy.training.provenance import policy_provenance

        quiet_libraries()
        torch.set_num_threads(self.jobs)
        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("runs"), TimeRemainingColumn())
        with Progress(TextColumn("{task.description}"), *columns, console=self.console) as progress:
            for amplitude, arm, seed in progress.track(self.missing(), description="scoring"):
                folder = self.policy(amplitude, arm, seed)
                policy, preprocess = load_policy(folder)
                val, test = (read_split(self.data(amplitude) / split) for split in ("val", "test"))
                score_run(
                    policy, preprocess, val, test, self.protocol, amplitude_mm=amplitude, arm=arm, seed=seed,
                    provenance=policy_provenance(policy, policy_folder(folder)),
                ).write(self.run_file(amplitude, arm, seed))  # fmt: skip

    def tallies(self) -> list[RunTally]:
        """The scored runs.

        Raises:
            FileNotFoundError: If there are none.
            ValueError: If one is damaged.
        """
        found = [read_tally(path) for run in self.budget.runs() if (path := self.run_file(*run)).is_file()]
        if not found:
            raise FileNotFoundError(f"{self.root / RUNS} holds no scored run: repeat the command without --only-grade")
        return found

    def keep(self, folder: Path) -> None:
        """Copy what the verdicts need into another folder.

        Raises:
            FileExistsError: If that holds anything.
        """
        if folder.exists() and any(folder.iterdir()):
            raise FileExistsError(f"{folder} is not empty: give another --keep, or delete it first")
        (folder / RUNS).mkdir(parents=True)
        shutil.copyfile(self.root / SETTINGS, folder / SETTINGS)
        for run in self.budget.runs():
            if (path := self.run_file(*run)).is_file():
                shutil.copyfile(path, folder / RUNS / path.name)
