"""The paper's numbers beside ours.

The figures needed are package data (``data/paper_numbers.csv``), as printed; the paper's rows other than its
exact both-valid ones use head-valid marginals, which the note of a comparison repeats.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

from dualhead_eval.effects.head_valid import head_valid_coordination
from dualhead_eval.gate.gate import Gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.report.content import Row
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.bootstrap import Interval

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
class PaperNumber:
    """One printed figure: a value, or a range in ``low`` and ``high``, over ``n`` runs."""

    source: str
    row: str
    quantity: str
    value: float | None
    low: float | None
    high: float | None
    n: int | None
    unit: str
    note: str


@cache
def paper_numbers() -> tuple[PaperNumber, ...]:
    """Every figure in the package's table."""
    text = resources.files("dualhead_eval.paper").joinpath("data/paper_numbers.csv").read_text()

    def number(cell: str) -> float | None:
        return float(cell) if cell else None

    return tuple(
        PaperNumber(
            row["source"],
            row["row"],
            row["quantity"],
            number(row["value"]),
            number(row["low"]),
            number(row["high"]),
            int(row["n"]) if row["n"] else None,
            row["unit"],
            row["note"],
        )
        for row in csv.DictReader(text.splitlines())
    )


def paper_row(name: str) -> dict[str, PaperNumber]:
    """Figures of one row by quantity; seed expansions (tab:seeds) and threshold scans are left out."""
    sources = ("tab:main", "tab:v3", "tab:maps", "tab:toy-corner", "sec:toy-occupancy")
    return {p.quantity: p for p in paper_numbers() if p.row == name and p.source in sources}


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
    note: str

    @property
    def difference(self) -> float:
        """Ours minus the paper's."""
        return self.ours - self.paper


def compare_with_paper(gates: Sequence[Gate], rows: Iterable[Row]) -> list[Comparison]:
    """Comparisons of the first pair of heads of every gate that has a row in the paper.

    Args:
        gates: The gates.
        rows: Their report rows (:func:`dualhead_eval.report.content.report_rows`), in any order.
    """
    # One row per gate: the first pair of heads.
    first = [row for row in rows if row.first_pair]
    comparisons = []
    for gate, row in zip(gates, first, strict=True):
        at_reference = (row.summary.tau, row.summary.nfe) == (gate.reference_tau, gate.reference_nfe)
        name = mechanism_of(gate).paper_row if at_reference else ""
        printed = paper_row(name)
        head_valid = head_valid_coordination(gate.pair_table()).run() if printed else {}
        for ours, theirs in QUANTITIES.items():
            if theirs not in printed:
                continue
            figure = printed[theirs]
            mine = residual_mm(gate) if ours == "residual_mm" else getattr(row.summary, ours)
            if figure.value is None or mine is None:
                continue
            interval = row.summary.intervals.get(ours)
            approximate = figure.source in ROBOT_TABLES and not name.startswith(EXACT_ROWS)
            comparisons.append(
                Comparison(
                    label=gate.label,
                    row=name,
                    source=figure.source,
                    quantity=ours,
                    ours=mine,
                    interval=interval,
                    paper=figure.value,
                    head_valid=head_valid.get(ours) if approximate else None,
                    n=figure.n,
                    note=figure.note if row.readable else row.reading,
                )
            )
    return comparisons


def residual_mm(gate: Gate) -> float | None:
    """Mean cross-head position residual at the reference point, None if the gate holds none."""
    if "position" not in gate.strata:
        return None
    return summarise_strata(gate.strata["position"].at(gate.index())).mean
