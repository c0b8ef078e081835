"""Sensitivity curves: a run's effect against the threshold and the integration steps (app:sensitivity).

Thresholds relabel the same samples; integration steps are separate samples. An effect without its threshold,
integration steps and valid-pair rate cannot be read, so curves always carry all three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dualhead_eval.gate import Gate
from dualhead_eval.statistics.run_summary import RunSummary, summarise_run


@dataclass(frozen=True)
class SensitivityCurve:
    """A run's summaries along one axis, the other held at its reference.

    Attributes:
        label: Name of the run.
        axis: ``"tau"`` or ``"nfe"``.
        reference: Reference value on that axis.
        points: Summaries in increasing order of the axis.
    """

    label: str
    axis: str
    reference: float
    points: tuple[RunSummary, ...]

    @property
    def positions(self) -> list[float]:
        """Values on the axis."""
        return [getattr(point, self.axis) for point in self.points]

    @property
    def swing(self) -> float:
        """Largest minus smallest defined rho along the curve; NaN if none is defined."""
        values = [point.rho for point in self.points if point.rho == point.rho]
        return max(values) - min(values) if values else float("nan")


def tau_curve(
    gate: Gate, *, heads: tuple[int, int] = (0, 1), nfe: int | None = None, draws: int = 500
) -> SensitivityCurve:
    """The run at every threshold scanned, at ``nfe`` steps (its reference by default)."""
    points = tuple(summarise_run(gate, heads=heads, tau=tau, nfe=nfe, draws=draws) for tau in gate.taus)
    return SensitivityCurve(gate.label, "tau", gate.reference_tau, points)


def nfe_curve(
    gate: Gate, *, heads: tuple[int, int] = (0, 1), tau: float | None = None, draws: int = 500
) -> SensitivityCurve:
    """The run at every number of steps scanned, at threshold ``tau`` (its reference by default)."""
    points = tuple(summarise_run(gate, heads=heads, tau=tau, nfe=nfe, draws=draws) for nfe in gate.nfes)
    return SensitivityCurve(gate.label, "nfe", float(gate.reference_nfe), points)


def curves(
    gates: Sequence[Gate], axis: str, *, tau: float | None = None, nfe: int | None = None
) -> list[SensitivityCurve]:
    """Curves of all gates that scanned more than one value of ``axis`` (``"tau"`` or ``"nfe"``).

    Args:
        gates: The gates.
        axis: What varies along a curve.
        tau: Threshold of the curves over integration steps, each gate's reference by default.
        nfe: Integration steps of the curves over thresholds, each gate's reference by default.

    Raises:
        ValueError: If the axis has another name.
    """
    if axis not in ("tau", "nfe"):
        raise ValueError(f"axis={axis!r}, expected 'tau' or 'nfe'")
    if axis == "tau":
        return [tau_curve(gate, nfe=nfe) for gate in gates if len(gate.taus) > 1]
    return [nfe_curve(gate, tau=tau) for gate in gates if len(gate.nfes) > 1]


def ranking_is_stable(lines: Sequence[SensitivityCurve], tie: float = 0.01) -> bool:
    """Whether no two runs change places by more than ``tie`` in delta anywhere that both are defined."""
    for i, first in enumerate(lines):
        for second in lines[i + 1 :]:
            others = dict(zip(second.positions, second.points, strict=True))
            gaps = [
                point.delta - others[position].delta
                for position, point in zip(first.positions, first.points, strict=True)
                if position in others
            ]
            gaps = [gap for gap in gaps if gap == gap]
            if gaps and max(gaps) > tie and min(gaps) < -tie:
                return False
    return True
