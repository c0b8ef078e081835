"""Runs beside the paper's rows: where each lies in the attainable region, and whether the paper's lies there too."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import PaperNumber, paper_row
from dualhead_eval.statistics.run import Run

_PRINTED_SITE = re.compile(r"\bsite (IV|III|II|I)\b")


@dataclass(frozen=True)
class SiteComparison:
    """One of our runs and the paper's row for its mechanism.

    Attributes:
        run: Our run.
        paper_name: The paper's row, for example ``"v2/K oracle"``.
        printed: Its figures by quantity.
        paper_site: ``"I"`` to ``"IV"``, ``"-"`` or ``"?"``.
        derived: Whether the paper prints no site for this row, so that it follows from its rho and C.
    """

    run: Run
    paper_name: str
    printed: dict[str, PaperNumber]
    paper_site: str
    derived: bool

    @property
    def site(self) -> str:
        """Our run's site."""
        return self.run.first.occupancy.site

    @property
    def agrees(self) -> bool:
        """Whether both runs lie at the same site."""
        return self.site == self.paper_site

    def paper_value(self, quantity: str) -> float | None:
        """The paper's printed value of a quantity, None where it prints none."""
        figure = self.printed.get(quantity)
        return None if figure is None else figure.value


def compare_sites(runs: Iterable[Run]) -> list[SiteComparison]:
    """The first pair of heads of every run that has a row in the paper, at its reference operating point."""
    compared = []
    for run in runs:
        name = mechanism_of(run.gate).paper_row
        printed = paper_row(name)
        if run.at_reference and "rho" in printed:
            site, derived = _paper_site(printed, run.gate.n_modes)
            compared.append(SiteComparison(run, name, printed, site, derived))
    return compared


def _paper_site(printed: dict[str, PaperNumber], n_modes: int) -> tuple[str, bool]:
    found = _PRINTED_SITE.search(printed["rho"].note)
    if found:
        return found.group(1), False
    rho, capacity = printed["rho"].value, printed["C"].value if "C" in printed else None
    if rho is None or capacity is None:
        return Occupancy.UNKNOWN.site, True
    return occupancy(rho, capacity, n_modes).site, True
