"""The stages of the demo; each writes files that the next reads, and is skipped where they exist."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from dualhead_eval.atomic_text import write_text
from dualhead_eval.evaluation.conditions import ConditionBank, open_conditions
from dualhead_eval.evaluation.open_loop import evaluate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler, open_exact_reference, open_policy
from dualhead_eval.gate import Gate, read_gate, write_gate
from dualhead_eval.studies.plan import Budget, Plan, PlannedRow
from dualhead_policy.sampling import SamplingCoupling

SETTINGS = "demo.json"


class Demo:
    """One demo in one folder.

    Args:
        plan: What to run.
        budget: How much.
        root: Folder of the demo.
        seed: Seed of recording, training and sampling.
        jobs: Policies trained at a time.
    """

    def __init__(self, plan: Plan, budget: Budget, root: Path, *, seed: int, jobs: int):
        self.plan, self.budget, self.root, self.seed, self.jobs = plan, budget, root, seed, jobs
        self.console = Console(stderr=True)

    def claim_folder(self) -> None:
        """Create the folder, or continue the same demo in it.

        Raises:
            FileExistsError: If the folder holds something else.
        """
        plan = {key: value for key, value in asdict(self.plan).items() if key != "budgets"}
        settings = {"plan": plan, "budget": asdict(self.budget), "seed": self.seed}
        text = json.dumps(settings, indent=2)
        path = self.root / SETTINGS
        if path.is_file():
            if json.loads(path.read_text()) != json.loads(text):
                raise FileExistsError(
                    f"{self.root} holds a demo with other settings: give another --output, or delete the folder"
                )
            self.console.print(f"Continuing the demo in {self.root}: finished stages are kept.")
            return
        if self.root.exists() and any(self.root.iterdir()):
            raise FileExistsError(f"{self.root} is not empty and holds no demo: give another --output")
        write_text(path, text)

    def record(self) -> None:
        """Record every dataset that is not there yet."""
        from dualhead_envs.record import record

        for dataset in self.plan.datasets:
            target = self.root / "data" / dataset.name
            if (target / "card.json").is_file():
                continue
            record(
                dataset.env_id,
                target,
                seed=self.seed,
                env_kwargs=dataset.env_kwargs,
                progress=True,
                **{dataset.size: self.budget.demonstrations},
            )

    def train(self) -> None:
        """Train every policy that is not finished, several at a time; interrupted ones are resumed."""
        from dualhead_policy.training.checkpoints import last_checkpoint
        from dualhead_policy.training.parallel import Run, train_runs

        runs = []
        for policy in self.plan.policies:
            output = self.root / "policies" / policy.name
            last = last_checkpoint(output)
            if last is not None and int(last.name) == self.budget.steps:
                continue
            flags = [
                f"--dataset.root={self.root / 'data' / policy.dataset / 'train'}",
                f"--dataset.repo_id=local/{policy.dataset}",
                f"--output_dir={output}",
                f"--seed={self.seed}",
                f"--steps={self.budget.steps}",
                f"--save_freq={self.budget.save_freq}",
                "--policy.device=cpu",
                *policy.flags,
            ]
            if last is not None:
                flags = ["--resume=true", f"--output_dir={output}"]
            runs.append(Run(policy.name, flags))
        if runs:
            train_runs(runs, jobs=self.jobs)

    def evaluate(self) -> list[tuple[PlannedRow, Gate, Gate | None]]:
        """Evaluate every row, and its reference where there is one; returns (row, trained, reference)."""
        total = sum(1 + (row.reference is not None) for row in self.plan.rows)
        results = []
        with Progress(console=self.console) as progress:
            task = progress.add_task("evaluating", total=total)
            datasets = {policy.name: policy.dataset for policy in self.plan.policies}
            for row in self.plan.rows:
                conditions = open_conditions(self.root / "data" / datasets[row.policy] / "test")
                progress.update(task, description=f"evaluating: {row.title}")
                trained = partial(open_policy, self.root / "policies" / row.policy)
                gate = self._gate(row, "trained", conditions, trained)
                progress.advance(task)
                reference = None
                if row.reference is not None:
                    exact = partial(open_exact_reference, conditions, **row.reference)
                    reference = self._gate(row, "reference", conditions, exact)
                    progress.advance(task)
                results.append((row, gate, reference))
        return results

    def _gate(
        self, row: PlannedRow, kind: str, conditions: ConditionBank, open_sampler: Callable[[], EvaluatedSampler]
    ) -> Gate:
        path = self.root / "gates" / f"{row.name}.{kind}.gate.json"
        if path.is_file():
            return read_gate(path)
        protocol = EvaluationProtocol(
            pairs=self.budget.pairs,
            seed=self.seed,
            coupling=SamplingCoupling(source_noise_beta=row.source_noise_beta),
        )
        label = row.title if kind == "trained" else f"{row.title} (reference)"
        gate = evaluate(open_sampler(), conditions, protocol, label)
        write_gate(gate, path)
        return gate


@contextmanager
def stage(console: Console, number: int, of: int, title: str) -> Iterator[None]:
    """Announce a stage of the demo and say how long it took."""
    start = time.perf_counter()
    console.print(f"[bold]({number}/{of})[/bold] {title}", highlight=False)
    yield
    console.print(f"      done in {time.perf_counter() - start:.0f} s", style="dim", highlight=False)
