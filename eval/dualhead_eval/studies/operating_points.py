"""A cell under other thresholds and numbers of Euler steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.statistics.run_summary import RunSummary, summarise_run
from dualhead_eval.studies.study_cells import StudyCell

#: Bootstrap replicates of a point; its interval is over seeds, and none of theirs is shown.
_DRAWS = 10


@dataclass(frozen=True)
class OperatingPoint:
    """The seeds of a cell at one threshold and number of Euler steps.

    Attributes:
        tau: The threshold.
        nfe: The number of Euler steps.
        seeds: Their summaries.
    """

    tau: float
    nfe: int
    seeds: tuple[RunSummary, ...]

    def values(self, name: str) -> NDArray[np.float64]:
        """A statistic of the seeds for which it is defined."""
        values = np.array([getattr(seed, name) for seed in self.seeds], dtype=np.float64)
        return values[~np.isnan(values)]

    def mean(self, name: str) -> float:
        """Its mean, NaN where no seed has it."""
        values = self.values(name)
        return float(values.mean()) if values.size else float("nan")


def operating_points(cell: StudyCell) -> list[OperatingPoint]:
    """Every threshold at the reference number of steps, then every other number of steps at the reference threshold.

    Seeds with few valid pairs are not left out: how the effect depends on a threshold that makes pairs invalid is the
    question.
    """
    gate = cell.runs[0].gate
    at = [(tau, gate.reference_nfe) for tau in sorted(gate.taus)]
    at += [(gate.reference_tau, nfe) for nfe in sorted(gate.nfes) if nfe != gate.reference_nfe]
    return [
        OperatingPoint(tau, nfe, tuple(summarise_run(run.gate, tau=tau, nfe=nfe, draws=_DRAWS) for run in cell.runs))
        for tau, nfe in at
    ]


def is_scanned(cell: StudyCell) -> bool:
    """Whether a finished cell was evaluated at more than one operating point."""
    gate = cell.runs[0].gate
    return cell.final and (len(gate.taus) > 1 or len(gate.nfes) > 1)
