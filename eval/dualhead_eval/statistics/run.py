"""A run: one gate at one operating point, with everything that was computed from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

from dualhead_eval.gate import Gate
from dualhead_eval.residuals.strata import ResidualSummary, summarise_strata
from dualhead_eval.statistics.head_agreement import HeadAgreement, all_heads_agreement
from dualhead_eval.statistics.run_summary import RunSummary, summarise_run
from dualhead_eval.statistics.training_record import TrainingRecord, training_record


@dataclass(frozen=True)
class Run:
    """A gate and its statistics at one operating point.

    Attributes:
        gate: The counts.
        pairs: Summary of every pair of heads; the gate's first two heads come first.
        residuals: Residual by component (``"position"``, ...).
        agreement: Agreement of all heads at once, None with two heads.
        training: The training behind it.
        name: What a report calls the run, so that no two of its runs have one name.
    """

    gate: Gate
    pairs: tuple[RunSummary, ...]
    residuals: dict[str, ResidualSummary]
    agreement: HeadAgreement | None
    training: TrainingRecord
    name: str = ""

    @property
    def first(self) -> RunSummary:
        """The gate's first two heads, which the paper's rows and claims are about."""
        return self.pairs[0]

    @property
    def label(self) -> str:
        """Name of the run."""
        return self.gate.label

    @property
    def at_reference(self) -> bool:
        """Whether this is the gate's reference threshold and number of integration steps."""
        return (self.first.tau, self.first.nfe) == (self.gate.reference_tau, self.gate.reference_nfe)

    @property
    def residual_mm(self) -> float | None:
        """Mean cross-head position residual, None if the gate holds none."""
        return self.residuals["position"].mean if "position" in self.residuals else None


def open_run(gate: Gate, *, tau: float | None = None, nfe: int | None = None) -> Run:
    """The run of ``gate`` at one operating point, its reference point by default.

    Raises:
        KeyError: If the gate does not hold the threshold or the number of steps.
    """
    pairs = tuple(summarise_run(gate, heads=pair, tau=tau, nfe=nfe) for pair in combinations(range(len(gate.heads)), 2))
    index = gate.index(tau, nfe)
    return Run(
        gate,
        pairs,
        {name: summarise_strata(strata.at(index)) for name, strata in gate.strata.items()},
        all_heads_agreement(gate, tau=tau, nfe=nfe) if len(gate.heads) > 2 else None,
        training_record(gate),
        gate.label,
    )


def open_runs(gates: Iterable[Gate], *, tau: float | None = None, nfe: int | None = None) -> list[Run]:
    """The runs of several gates, each at the same operating point (by default its own reference)."""
    return [open_run(gate, tau=tau, nfe=nfe) for gate in gates]
