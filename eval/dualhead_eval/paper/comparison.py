"""Runs beside the paper's rows, one line a run: the numbers that matter, and whether both lie at the same site."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.gate.gate import Gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import PaperNumber, paper_row, residual_mm
from dualhead_eval.report.content import RHO, Row

#: What the sites are called where the paper speaks of them.
SITE_NAMES = {"I": "floor", "II": "origin", "III": "interior", "IV": "corner", "-": "negative", "?": "unknown"}
_PRINTED_SITE = re.compile(r"\bsite (IV|III|II|I)\b")


@dataclass(frozen=True)
class SiteComparison:
    """One of our runs and the paper's row for its mechanism.

    Attributes:
        row: Our run.
        residual: Our mean cross-head residual in mm, or None.
        paper_name: The paper's row, for example ``"v2/K oracle"``.
        printed: Its figures by quantity.
        paper_site: ``"I"`` to ``"IV"``, ``"-"`` or ``"?"``.
        derived: Whether the paper prints no site for this row, so that it follows from its rho and C.
    """

    row: Row
    residual: float | None
    paper_name: str
    printed: dict[str, PaperNumber]
    paper_site: str
    derived: bool

    @property
    def site(self) -> str:
        """Our run's site."""
        return self.row.summary.occupancy.site

    @property
    def agrees(self) -> bool:
        """Whether both runs lie at the same site."""
        return self.site == self.paper_site

    def cells(self) -> tuple[str, ...]:
        """A table's cells: run, paper's row, valid-pair rate, rho, difference, residual, site, same site or not."""
        s, rho = self.row.summary, self._value("rho")
        return (
            s.label,
            self.paper_name,
            _pair(s.valid_rate, self._value("valid_pair_rate"), ".3f"),
            _pair(s.rho, rho, "+.1%"),
            "" if rho is None or s.rho != s.rho else f"{100 * (s.rho - rho):+.1f} points",
            _pair(self.residual, self._value("residual_mm"), ".1f"),
            f"{self.site} / {self.paper_site}{'*' if self.derived else ''}",
            "yes" if self.agrees else "NO",
        )

    def _value(self, quantity: str) -> float | None:
        figure = self.printed.get(quantity)
        return None if figure is None else figure.value


def compare_sites(gates: Sequence[Gate], rows: Iterable[Row]) -> list[SiteComparison]:
    """The first pair of heads of every gate that has a row in the paper, at its reference operating point."""
    compared = []
    for gate, row in zip(gates, (row for row in rows if row.first_pair), strict=True):
        if (row.summary.tau, row.summary.nfe) != (gate.reference_tau, gate.reference_nfe):
            continue
        name = mechanism_of(gate).paper_row
        printed = paper_row(name)
        if "rho" not in printed:
            continue
        site, derived = _paper_site(printed, gate.n_modes)
        compared.append(SiteComparison(row, residual_mm(gate), name, printed, site, derived))
    return compared


def _paper_site(printed: dict[str, PaperNumber], n_modes: int) -> tuple[str, bool]:
    found = _PRINTED_SITE.search(printed["rho"].note)
    if found:
        return found.group(1), False
    rho, capacity = printed["rho"].value, printed["C"].value if "C" in printed else None
    if rho is None or capacity is None:
        return Occupancy.UNKNOWN.site, True
    return occupancy(rho, capacity, n_modes).site, True


def render_sites(comparisons: Sequence[SiteComparison]) -> Group:
    """The comparisons as a table, with what its columns mean and what disagrees."""
    title = "Beside the paper's rows (ours / paper)"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("run", overflow="fold", min_width=20)
    table.add_column("the paper's row", overflow="fold", min_width=16)
    for name in ("valid", RHO, "difference", "residual mm", "site"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("same?", no_wrap=True)
    for c in comparisons:
        table.add_row(*c.cells())
    return Group(table, *site_notes(comparisons))


def site_notes(comparisons: Sequence[SiteComparison]) -> list[str]:
    """What the sites are, how many agree, and which do not."""
    sites = ", ".join(f"{numeral} {name}" for numeral, name in SITE_NAMES.items() if numeral not in "-?")
    notes = [f"site: where the run lies in the attainable region ({sites}; - negative)"]
    if any(c.derived for c in comparisons):
        notes.append("* the paper prints no site for this row: it follows from its rho and C by the same thresholds")
    different = [c for c in comparisons if not c.agrees]
    total = len(comparisons)
    notes.append(f"{total - len(different)} of {total} runs lie at the paper's site")
    notes += [
        f"  not {c.row.summary.label}: {_site(c.site)}, where the paper has {_site(c.paper_site)}" for c in different
    ]
    return notes


def _pair(ours: float | None, paper: float | None, spec: str) -> str:
    cells = ["-" if x is None else "undefined" if x != x else format(x, spec) for x in (ours, paper)]
    return " / ".join(cells)


def _site(numeral: str) -> str:
    return f"{SITE_NAMES[numeral]} {numeral}" if numeral in ("I", "II", "III", "IV") else SITE_NAMES[numeral]
