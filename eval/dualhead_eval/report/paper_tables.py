"""Tables of the runs beside the paper's rows, and of its claims on them."""

from __future__ import annotations

from dualhead_eval.effects.sites import SITE_NAMES
from dualhead_eval.paper.sites import SiteComparison
from dualhead_eval.report.content import Report
from dualhead_eval.report.table import RHO, Cell, Column, Table, bounds, number

NO_ROW = "None of these runs has the setting of a row in the paper."


def sites_table(report: Report) -> Table:
    """One line a run: the numbers that matter, and whether both lie at the same site."""
    lines = []
    for c in report.sites:
        s, rho = c.run.first, c.paper_value("rho")
        gap = "" if rho is None or s.rho != s.rho else f"{100 * (s.rho - rho):+.1f} points"
        lines.append(
            (
                c.run.name,
                c.paper_name,
                _both(s.valid_rate, c.paper_value("valid_pair_rate"), ".3f"),
                _both(s.rho, rho, "+.1%"),
                gap,
                _both(c.run.residual_mm, c.paper_value("residual_mm"), ".1f"),
                f"{c.site} / {c.paper_site}{'*' if c.derived else ''}",
                "yes" if c.agrees else Cell("NO"),
            )
        )
    columns = (
        Column("run", text=True),
        Column("the paper's row", text=True),
        Column("valid"),
        Column(RHO),
        Column("difference"),
        Column("residual mm"),
        Column("site", f"where the run lies in the attainable region ({_site_names()}; - negative)"),
        Column("same?"),
    )
    return Table(
        "Beside the paper's rows (ours / paper)",
        columns,
        tuple(lines),
        notes=tuple(_notes(report.sites)) if lines else _nothing(report),
    )


def _notes(sites: tuple[SiteComparison, ...]) -> list[str]:
    notes = []
    if any(c.derived for c in sites):
        notes.append("* the paper prints no site for this row: it follows from its rho and C by the same thresholds")
    different = [c for c in sites if not c.agrees]
    notes.append(f"{len(sites) - len(different)} of {len(sites)} runs lie at the paper's site")
    notes += [f"not {c.run.name}: {_site(c.site)}, where the paper has {_site(c.paper_site)}" for c in different]
    return notes


def comparisons_table(report: Report) -> Table:
    """Ours and the paper's, one line a quantity."""
    lines = []
    for c in report.comparisons:
        spec = ".1f" if c.quantity == "residual_mm" else ".4f"
        lines.append(
            (
                c.label,
                c.row,
                c.source,
                c.quantity,
                number(c.ours, spec),
                bounds(c.interval, spec),
                "" if c.head_valid is None else number(c.head_valid, spec),
                number(c.paper, spec),
                number(c.difference, "+" + spec),
                str(c.n or ""),
                c.note,
            )
        )
    columns = (
        Column("run", text=True),
        Column("the paper's row", text=True),
        Column("source", text=True, detail=True),
        Column("quantity", text=True),
        Column("ours"),
        Column("95% (conditions)"),
        Column("head-valid", "ours under the approximation that the paper's row uses", detail=True),
        Column("paper", "mean over its seeds; most of its rows use head-valid marginals, ours the exact ones"),
        Column("difference"),
        Column("seeds", "of the paper"),
        Column("note", text=True, detail=True),
    )
    title = "Every quantity beside the paper's"
    return Table(title, columns, tuple(lines), notes=() if lines else _nothing(report), every_quantity=True)


def claims_table(report: Report) -> Table:
    """The claims of tab:claims with their grades."""
    columns = (
        Column("claim", text=True),
        Column("grade", text=True),
        Column("evidence", text=True),
        Column("criterion", text=True, detail=True),
    )
    lines = tuple((grade.claim, grade.grade, grade.evidence, grade.criterion) for grade in report.claims)
    return Table("The paper's claims on these runs", columns, lines)


def _nothing(report: Report) -> tuple[str, ...]:
    return (report.reference_only or NO_ROW,)


def _both(ours: float | None, paper: float | None, spec: str) -> str:
    return f"{number(ours, spec)} / {number(paper, spec)}"


def _site(numeral: str) -> str:
    return f"{SITE_NAMES[numeral]} {numeral}" if numeral in ("I", "II", "III", "IV") else SITE_NAMES[numeral]


def _site_names() -> str:
    return ", ".join(f"{numeral} {name}" for numeral, name in SITE_NAMES.items() if numeral not in "-?")
