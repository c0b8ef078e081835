"""The content of a report, computed once at one operating point: what every table, figure and page reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dualhead_eval.evaluation.rollouts import ClosedLoop
from dualhead_eval.gate import Gate
from dualhead_eval.paper.claims import Grade, grade_claims
from dualhead_eval.paper.comparison import Comparison, compare_with_paper
from dualhead_eval.paper.contradictions import contradictions
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.sites import SiteComparison, compare_sites, criterion_contradiction
from dualhead_eval.statistics.family_summary import FamilySummary, find_families
from dualhead_eval.statistics.run import Run, open_runs
from dualhead_eval.statistics.run_summary import RunSummary
from dualhead_eval.statistics.seeds import benjamini_hochberg
from dualhead_eval.statistics.sensitivity import SensitivityCurve, curves

#: Partition name to what an environment is called on the command line.
ENVIRONMENTS = {"ring": "ring", "bypass-v2": "v2", "bypass-v2-three-ways": "v2, three ways", "rotating-v3": "v3"}


@dataclass(frozen=True)
class Report:
    """Everything that a report says.

    Attributes:
        runs: Every gate with the summaries of its pairs of heads, residuals and agreement of all heads.
        families: Mechanisms of which several seeds are among the runs.
        loops: Closed-loop outcomes by name; they depend on no threshold and no number of steps.
        comparisons: Our numbers beside the paper's, for runs at their reference point.
        sites: Sites beside the paper's, for runs at their reference point.
        claims: The paper's claims graded on the runs.
        contradictions: The paper's rows that the runs touch, with what their printed numbers contradict.
        tau: Threshold asked for, None for each gate's reference.
        nfe: Integration steps asked for, None for each gate's reference.
    """

    runs: tuple[Run, ...]
    families: tuple[FamilySummary, ...]
    loops: tuple[tuple[str, ClosedLoop], ...]
    comparisons: tuple[Comparison, ...]
    sites: tuple[SiteComparison, ...]
    claims: tuple[Grade, ...]
    contradictions: tuple[tuple[str, str], ...]
    tau: float | None = None
    nfe: int | None = None

    @property
    def pairs(self) -> tuple[RunSummary, ...]:
        """Every pair of heads of every run."""
        return tuple(pair for run in self.runs for pair in run.pairs)

    @property
    def run_pairs(self) -> list[tuple[Run, RunSummary]]:
        """Every pair of heads with its run."""
        return [(run, pair) for run in self.runs for pair in run.pairs]

    @property
    def reference_only(self) -> str:
        """Why runs do not stand beside the paper's rows; empty if all are at their reference point."""
        away = [run for run in self.runs if not run.at_reference]
        if not away:
            return ""
        first = away[0]
        return (
            f"The paper's rows hold at the reference point alone (tau {first.gate.reference_tau:g}, "
            f"{first.gate.reference_nfe} steps): {len(away)} of {len(self.runs)} runs are reported at another "
            f"(tau {first.first.tau:g}, {first.first.nfe} steps) and do not stand beside them."
        )

    @cached_property
    def tau_curves(self) -> list[SensitivityCurve]:
        """Effects against the threshold, at the report's number of steps."""
        return self._curves("tau")

    @cached_property
    def nfe_curves(self) -> list[SensitivityCurve]:
        """Effects against the number of steps, at the report's threshold."""
        return self._curves("nfe")

    def _curves(self, axis: str) -> list[SensitivityCurve]:
        names = {id(run.gate): run.name for run in self.runs}
        gates = [run.gate for run in self.runs if len(run.gate.taus if axis == "tau" else run.gate.nfes) > 1]
        return [
            replace(curve, label=names[id(gate)])
            for gate in gates
            for curve in curves([gate], axis, tau=self.tau, nfe=self.nfe)
        ]


def make_report(
    gates: Sequence[Gate],
    loops: Iterable[tuple[str, ClosedLoop]] = (),
    *,
    tau: float | None = None,
    nfe: int | None = None,
) -> Report:
    """Compute a report.

    Args:
        gates: The runs.
        loops: Closed-loop outcomes by name.
        tau: Threshold of the partition, by default each gate's reference.
        nfe: Integration steps, by default each gate's reference.

    Raises:
        KeyError: If a gate does not hold the threshold or the number of steps asked for.
    """
    runs = _adjusted(_named(open_runs(gates, tau=tau, nfe=nfe)))
    return Report(
        runs=tuple(runs),
        families=tuple(find_families(runs)),
        loops=tuple(loops),
        comparisons=tuple(compare_with_paper(runs)),
        sites=tuple(compare_sites(runs)),
        claims=tuple(grade_claims(runs)),
        contradictions=tuple(_contradictions(runs)),
        tau=tau,
        nfe=nfe,
    )


def _contradictions(runs: Iterable[Run]) -> list[tuple[str, str]]:
    rows = dict.fromkeys(mechanism_of(run.gate).touched_row for run in runs)
    found = [(row, text) for row in rows for text in (*contradictions(row), criterion_contradiction(row))]
    return [(row, text) for row, text in found if text]


def _named(runs: Sequence[Run]) -> list[Run]:
    """Runs with names that differ: the environment where there are several, a number where labels collide."""
    several_environments = len({run.first.partition for run in runs}) > 1
    several_pairs = len({pair.heads for run in runs for pair in run.pairs}) > 1
    labels = []
    for run in runs:
        environment = ENVIRONMENTS.get(run.first.partition, run.first.partition or "elsewhere")
        labels.append(f"{environment} {run.label}" if several_environments else run.label)
    repeated, seen, named = Counter(labels), Counter[str](), []
    for run, label in zip(runs, labels, strict=True):
        seen[label] += 1
        name = f"{label} #{seen[label]}" if repeated[label] > 1 else label
        pairs = tuple(
            replace(pair, name=f"{name} ({'-'.join(pair.heads)})" if several_pairs else name) for pair in run.pairs
        )
        named.append(replace(run, name=name, pairs=pairs))
    return named


def _adjusted(runs: Sequence[Run]) -> list[Run]:
    """Runs whose p-values are adjusted together: every pair of heads whose rho is defined is one family of tests."""
    p_values = np.array([pair.p_value for run in runs for pair in run.pairs])
    defined = np.isfinite(p_values)
    if defined.any():
        p_values[defined] = benjamini_hochberg(p_values[defined])
    adjusted = iter(p_values.tolist())
    return [
        replace(run, pairs=tuple(replace(pair, adjusted_p_value=next(adjusted)) for pair in run.pairs)) for run in runs
    ]


def report_json(report: Report) -> list[dict[str, Any]]:
    """One JSON object for every pair of heads of every run; undefined numbers are null."""
    objects = []
    for run, pair in report.run_pairs:
        summary = asdict(pair)
        summary["occupancy"] = {
            "site": pair.occupancy.site,
            "word": pair.occupancy.word,
            "meaning": pair.occupancy.meaning,
        }
        summary |= {"readable": pair.readable, "reading": pair.reading, "loss": run.training.loss}
        summary |= {"seed": run.training.seed, "steps": run.training.steps, "network": run.training.network_name}
        summary["equivalence"]["verdict"] = pair.equivalence.verdict
        objects.append(_without_nan(summary))
    return objects


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and value != value else value
