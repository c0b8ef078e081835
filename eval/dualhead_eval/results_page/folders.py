"""Runs of the folders that a template names, with what it says of each folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dualhead_eval.evaluation.rollouts import ClosedLoop
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.sites import SiteComparison, compare_sites
from dualhead_eval.report.inputs import read_inputs
from dualhead_eval.results_page.template import percent
from dualhead_eval.statistics.run import Run, open_runs

#: What a row says of a field of the policy that was another one in sampling.
SAMPLED_OTHERWISE = {
    "source_noise_beta": "noise shared in sampling alone",
    "source_noise_alignment": "noise aligned by the kinematic map in sampling alone",
    "token_draw": "token drawn otherwise in sampling alone",
}


@dataclass(frozen=True)
class NamedRun:
    """A run as the page names it.

    Attributes:
        run: The run.
        note: What the template says of its folder.
        beside: The paper's row beside it, None if it has none.
    """

    run: Run
    note: str
    beside: SiteComparison | None

    @property
    def environment(self) -> str:
        """``v2``, ``v3`` or ``testbed``; empty elsewhere."""
        return mechanism_of(self.run.gate).environment

    @property
    def name(self) -> str:
        """The gate's label without its steps, with the environment, the note and what was shared in sampling alone."""
        name = f"{self.environment} {self.run.gate.label.partition(',')[0]}"
        if self.note:
            name += f", {self.note}"
        coupling, config = (self.run.gate.provenance.get(part) or {} for part in ("coupling", "config"))
        for field, remark in SAMPLED_OTHERWISE.items():
            sampled = coupling.get(field)
            if sampled is not None and field in config and sampled != config[field]:
                name += f" ({remark})"
        return name

    @property
    def steps(self) -> str:
        """Training steps with separators; empty for an optimum."""
        return "" if self.run.training.steps is None else f"{self.run.training.steps:,}"

    @property
    def rho(self) -> str:
        """rho in percent, with its interval over conditions."""
        return rho_with_interval(self.run)


def rho_with_interval(run: Run) -> str:
    """rho in percent, with its 95% interval over conditions."""
    interval = run.first.intervals["rho"]
    if run.first.rho != run.first.rho:
        return "undefined"
    return f"{percent(run.first.rho)} [{100 * interval.low:+.1f}, {100 * interval.high:+.1f}]"


def named_runs(arguments: Sequence[str]) -> Iterator[NamedRun]:
    """The runs of ``FOLDER`` or ``FOLDER=NOTE`` arguments, in order.

    Raises:
        FileNotFoundError: If a folder holds no results.
        ValueError: If none is named, or a file is damaged.
    """
    if not arguments:
        raise ValueError("no folder of results is named, expected FOLDER or FOLDER=NOTE")
    for argument in arguments:
        folder, _, note = argument.partition("=")
        runs, beside = _opened(Path(folder))
        for run in runs:
            yield NamedRun(run, note, beside.get(id(run)))


def closed_loops(folder: str) -> list[tuple[str, ClosedLoop]]:
    """The closed-loop outcomes in a folder, by name."""
    return read_inputs([Path(folder)]).loops


@cache
def _opened(folder: Path) -> tuple[list[Run], dict[int, SiteComparison]]:
    runs = list(open_runs(read_inputs([folder]).gates))
    return runs, {id(found.run): found for found in compare_sites(runs)}
