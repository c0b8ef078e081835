"""Runs beside the paper's rows: the site that the paper assigns, and whether a run lies within its seeds' spread."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources

from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.paper.contradictions import contradictions
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import PaperNumber, paper_row
from dualhead_eval.paper.seed_spread import seed_spread
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run import Run


@dataclass(frozen=True)
class SiteComparison:
    """One of our runs and the paper's row for its mechanism.

    Attributes:
        run: Our run.
        paper_name: The paper's row, for example ``"v2/K oracle"``.
        printed: Its figures by quantity.
        paper_site: The site that the paper's tables or text assign, ``"?"`` where they assign none.
        spread: Where one more of the paper's seeds is expected, None where it prints no spread.
        contradicted: Whether some of the row's printed figures contradict each other.
    """

    run: Run
    paper_name: str
    printed: dict[str, PaperNumber]
    paper_site: str
    spread: Interval | None
    contradicted: bool

    @property
    def site(self) -> str:
        """Our run's site."""
        return self.run.first.occupancy.site

    @property
    def agrees(self) -> bool | None:
        """Whether both lie at the same site, None where either has none."""
        if Occupancy.UNKNOWN.site in (self.site, self.paper_site):
            return None
        return self.site == self.paper_site

    @property
    def within_spread(self) -> bool | None:
        """Whether our rho could be that of one more of the paper's seeds, None where it prints no spread.

        Our rho is known up to its interval over conditions, the paper's spread is that of seeds on its own conditions:
        ours is inside if the two meet.
        """
        rho, interval = self.run.first.rho, self.run.first.intervals["rho"]
        if self.spread is None or rho != rho:
            return None
        if interval.low != interval.low:
            return rho in self.spread
        return bool(interval.low <= self.spread.high and interval.high >= self.spread.low)

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
            contradicted = bool(contradictions(name) or criterion_contradiction(name))
            compared.append(SiteComparison(run, name, printed, paper_site(name), seed_spread(name), contradicted))
    return compared


@cache
def _assigned() -> dict[str, tuple[str, str]]:
    text = resources.files("dualhead_eval.paper").joinpath("data/paper_sites.csv").read_text()
    return {line["row"]: (line["site"], line["source"]) for line in csv.DictReader(text.splitlines())}


def paper_site(row: str) -> str:
    """The site that the paper's tables or text assign to a row; ``"?"`` where they assign none."""
    return _assigned().get(row, (Occupancy.UNKNOWN.site, ""))[0]


def criterion_contradiction(row: str) -> str:
    """Where a row's assigned site is not the one that its printed rho and C give; empty where they agree."""
    site, source = _assigned().get(row, (Occupancy.UNKNOWN.site, ""))
    printed = paper_row(row)
    rho, capacity = (printed[name].value if name in printed else None for name in ("rho", "C"))
    if site == Occupancy.UNKNOWN.site or rho is None or capacity is None:
        return ""
    # Every robot row has two modes; the testbed's rows print no capacity.
    found = occupancy(rho, capacity, 2)
    if found.site == site:
        return ""
    return f"{source} places it at site {site}; its rho {rho:+.1%} and C {capacity:.4f} lie at site {found.site}"
