"""Our numbers beside the paper's, quantity by quantity.

The paper's rows other than its exact both-valid ones use head-valid marginals, so that a comparison carries ours
under that approximation too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from dualhead_eval.effects.head_valid import head_valid_coordination
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run import Run

#: Our statistic to the paper's quantity.
QUANTITIES = {
    "obs": "obs",
    "bl": "BL",
    "delta": "delta",
    "capacity": "C",
    "rho": "rho",
    "valid_rate": "valid_pair_rate",
    "residual_mm": "residual_mm",
}
#: Tables of robot runs, whose rows use head-valid marginals but for the families of tab:caliber.
ROBOT_TABLES = {"tab:main", "tab:v3"}
EXACT_ROWS = ("v2/C ", "v2/D ", "v2/E ", "v2/H ", "v2/I ")


@dataclass(frozen=True)
class Comparison:
    """One of our numbers beside the paper's.

    Attributes:
        label: Name of our run.
        row: The paper's row.
        source: The paper's table.
        quantity: Name of our statistic.
        ours: Our value.
        interval: Our 95% interval over conditions, if there is one.
        paper: The paper's value; figures printed as a range are left out.
        head_valid: Ours under the head-valid approximation, for rows that the paper computed so (None else).
        n: Runs behind the paper's value.
        loss: Whether our run's loss had settled.
        note: The paper's remark on its value, or why ours cannot be read.
    """

    label: str
    row: str
    source: str
    quantity: str
    ours: float
    interval: Interval | None
    paper: float
    head_valid: float | None
    n: int | None
    loss: str
    note: str

    @property
    def difference(self) -> float:
        """Ours minus the paper's."""
        return self.ours - self.paper


def compare_with_paper(runs: Iterable[Run]) -> list[Comparison]:
    """Comparisons of the first pair of heads of every run that has a row in the paper.

    The paper's rows hold at the frozen protocol's threshold and steps: runs at another point are left out.
    """
    comparisons = []
    for run in runs:
        name = mechanism_of(run.gate).paper_row if run.at_reference else ""
        printed = paper_row(name)
        head_valid = head_valid_coordination(run.gate.pair_table()).run() if printed else {}
        for ours, theirs in QUANTITIES.items():
            if theirs not in printed:
                continue
            figure = printed[theirs]
            mine = run.residual_mm if ours == "residual_mm" else getattr(run.first, ours)
            if figure.value is None or mine is None:
                continue
            approximate = figure.source in ROBOT_TABLES and not name.startswith(EXACT_ROWS)
            comparisons.append(
                Comparison(
                    label=run.name,
                    row=name,
                    source=figure.source,
                    quantity=ours,
                    ours=mine,
                    interval=run.first.intervals.get(ours),
                    paper=figure.value,
                    head_valid=head_valid.get(ours) if approximate else None,
                    n=figure.n,
                    loss=run.training.loss,
                    note=figure.note if run.first.readable else run.first.reading,
                )
            )
    return comparisons
