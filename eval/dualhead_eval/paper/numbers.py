"""The paper's printed figures that a report needs, as package data (``data/paper_numbers.csv``)."""

from __future__ import annotations

import csv
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib import resources


@dataclass(frozen=True)
class PaperNumber:
    """One printed figure: a value, or a range in ``low`` and ``high``, over ``n`` runs.

    ``resolution`` is half a unit of its last printed digit: what rounding may have hidden.
    """

    source: str
    row: str
    quantity: str
    value: float | None
    low: float | None
    high: float | None
    n: int | None
    unit: str
    note: str
    resolution: float


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
            0.5 * 10.0 ** -len(row["value"].partition(".")[2]),
        )
        for row in csv.DictReader(text.splitlines())
    )


#: The paper's main tables; seed expansions (tab:seeds), threshold scans and the like are others.
MAIN_TABLES = ("tab:main", "tab:v3", "tab:maps", "tab:toy-corner", "sec:toy-occupancy")


def paper_row(name: str, sources: Collection[str] = MAIN_TABLES) -> dict[str, PaperNumber]:
    """Figures of one row by quantity, from the main tables or others."""
    return {p.quantity: p for p in paper_numbers() if p.row == name and p.source in sources}
