"""Cells of a study: the seeds of one configuration, budget, checkpoint and bank on one dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run import Run, open_run
from dualhead_eval.statistics.seeds import seed_t_interval
from dualhead_eval.statistics.training_record import settled
from dualhead_eval.studies.gate_store import StudyResult
from dualhead_eval.studies.study_plan import StudyPlan, shown_budget


@dataclass(frozen=True)
class StudyCell:
    """The seeds of one cell.

    Attributes:
        dataset, configuration, budget, step, bank: The cell.
        results: The seeds that are there, in the order of the plan.
        runs: Their runs, at the gates' reference point.
        planned: Seeds that the study asks for.
        heads: The pair of heads that its numbers are about, where it is not the first.
    """

    dataset: str
    configuration: str
    budget: int
    step: int
    bank: str
    results: tuple[StudyResult, ...]
    runs: tuple[Run, ...]
    planned: tuple[int, ...]
    heads: tuple[str, str] | None = None

    @property
    def name(self) -> str:
        """``DATASET/CONFIGURATION-BUDGET``; the step where it is not the last, the heads where not the first two."""
        at = "" if self.step == self.budget else f" at {shown_budget(self.step)}"
        heads = "" if self.heads is None else f" {'-'.join(self.heads)}"
        return f"{self.dataset}/{self.configuration}-{shown_budget(self.budget)}{at}{heads}"

    def of_heads(self, heads: Sequence[str]) -> StudyCell:
        """The same cell with its numbers about another pair of its heads.

        Raises:
            ValueError: If its runs do not have both.
        """
        runs = []
        for run in self.runs:
            own = [pair for pair in run.pairs if set(pair.heads) == set(heads)]
            if not own:
                raise ValueError(
                    f"{self.name} has the heads {', '.join(run.gate.heads)}, a criterion asks for "
                    f"{' and '.join(heads)}: mend the study's file"
                )
            runs.append(replace(run, pairs=(*own, *(pair for pair in run.pairs if pair not in own))))
        return replace(self, runs=tuple(runs), heads=runs[0].first.heads)

    @property
    def final(self) -> bool:
        """Whether it is the end of its runs."""
        return self.step == self.budget

    @property
    def valid(self) -> tuple[Run, ...]:
        """The seeds that are, on the ring, valid enough to be read; a collapsed one may be."""
        return tuple(run for run in self.runs if run.first.readable or run.first.partition != "ring")

    @property
    def read(self) -> tuple[Run, ...]:
        """The seeds whose rho can be read: valid enough, and defined."""
        return tuple(run for run in self.valid if run.first.rho == run.first.rho)

    @property
    def valid_rate(self) -> float:
        """Mean share of valid pairs over all seeds."""
        return float(np.mean([run.first.valid_rate for run in self.runs]))

    def by_seed(self, name: str) -> dict[int, float]:
        """A statistic of the seeds that can be read, by training seed."""
        read = set(map(id, self.read))
        return {
            result.seed: float(getattr(run.first, name))
            for result, run in zip(self.results, self.runs, strict=True)
            if id(run) in read
        }

    def values(self, name: str) -> NDArray[np.float64]:
        """A statistic of the seeds that can be read."""
        return np.array(list(self.by_seed(name).values()), dtype=np.float64)

    def mean(self, name: str) -> float:
        """Mean of a statistic over the seeds that can be read, NaN without one."""
        values = self.values(name)
        return float(values.mean()) if values.size else float("nan")

    def interval(self, name: str = "rho") -> Interval | None:
        """Student's t interval of the mean over seeds, None with fewer than two."""
        values = self.values(name)
        return seed_t_interval(values) if values.size > 1 else None

    @property
    def n_modes(self) -> int:
        """Number of modes K."""
        return self.runs[0].gate.n_modes

    @property
    def site(self) -> Occupancy:
        """Site of the mean point."""
        return occupancy(self.mean("rho"), self.mean("capacity"), self.n_modes)

    @property
    def paper_row(self) -> str:
        """The row of the paper's main tables for its mechanism; empty if they have none."""
        row = mechanism_of(self.runs[0].gate).paper_row
        return row if paper_row(row) else ""

    @property
    def target_capacity(self) -> float:
        """Capacity of two heads that both follow the data's mode frequencies; NaN where these are unknown."""
        target = self.runs[0].gate.target_probabilities
        return float("nan") if target is None else float(1 - (target**2).sum())

    @property
    def loss(self) -> str:
        """How many seeds had a settled loss."""
        return settled([run.training for run in self.runs])

    @property
    def shortage(self) -> str:
        """What the study asks for and is not there, or cannot be read, in words; empty if nothing."""
        there = {result.seed for result in self.results}
        parts = [f"seed {seed} missing" for seed in self.planned if seed not in there]
        if unread := len(self.runs) - len(self.read):
            parts.append(f"{unread} of {len(self.runs)} seeds cannot be read (undefined, or too few valid pairs)")
        return ", ".join(parts)


def study_cells(plan: StudyPlan, results: Iterable[StudyResult]) -> list[StudyCell]:
    """The cells of a plan of which at least one seed is there, in the plan's order."""
    found = {(r.dataset, r.configuration, r.budget, r.step, r.bank, r.seed): r for r in results}
    planned: dict[tuple[str, str, int, int, str], list[int]] = {}
    for evaluation in plan.evaluations:
        run = evaluation.run
        key = (run.dataset, run.configuration, run.steps, evaluation.step, evaluation.bank)
        planned.setdefault(key, []).append(run.seed)
    cells = []
    for key, seeds in planned.items():
        there = tuple(found[(*key, seed)] for seed in sorted(seeds) if (*key, seed) in found)
        if there:
            runs = tuple(open_run(result.gate) for result in there)
            cells.append(StudyCell(*key, there, runs, tuple(sorted(seeds))))
    return cells


def common_seeds(cells: Sequence[StudyCell]) -> list[int]:
    """Seeds that can be read in every cell."""
    return sorted(set.intersection(*(set(cell.by_seed("rho")) for cell in cells))) if cells else []
