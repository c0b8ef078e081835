"""Tables of the runs beside the paper's rows, and of its claims on them."""

from __future__ import annotations

from dualhead_eval.effects.sites import SITE_NAMES
from dualhead_eval.paper.setting import NOTHING, departures
from dualhead_eval.paper.sites import SiteComparison
from dualhead_eval.report.content import Report
from dualhead_eval.report.table import LOSS, RHO, Cell, Column, Table, bounds, number

NO_ROW = "None of these runs has the setting of a row in the paper."


def sites_table(report: Report) -> Table:
    """One line per run: the numbers that matter, whether both lie at one site, and within the spread of its seeds."""
    lines = [_site_line(c) for c in report.sites]
    columns = (
        Column("run", text=True),
        Column("the paper's row", text=True),
        Column("valid"),
        Column(RHO),
        Column("spread", f"where {RHO} of one more of the paper's seeds is expected (95%), in percent"),
        Column("inside?", f"whether our {RHO}, known up to its interval over conditions, can lie there"),
        Column("residual mm"),
        Column("departs in", "what of our training is not the paper's (sec:models)", text=True, detail=True),
        LOSS,
        Column("site", f"where the run lies in the attainable region ({_site_names()}; - negative, ? not assigned)"),
        Column("same?"),
    )
    return Table(
        "Beside the paper's rows (ours / paper)",
        columns,
        tuple(lines),
        notes=tuple(_notes(report.sites)) if lines else _nothing(report),
    )


def differences_table(report: Report) -> Table:
    """The runs that lie at another site than the paper's row, or outside the spread of its seeds."""
    differing = [c for c in report.sites if c.agrees is False or c.within_spread is False]
    columns = (
        Column("run", text=True),
        Column("the paper's row", text=True),
        Column(RHO),
        Column("spread", f"where {RHO} of one more of the paper's seeds is expected (95%), in percent"),
        Column("valid"),
        Column("site", f"where the run lies in the attainable region ({_site_names()}; - negative, ? not assigned)"),
        LOSS,
        Column("departs in", "what of our training is not the paper's (sec:models)", text=True),
    )
    lines = tuple(
        (
            c.run.name,
            c.paper_name + (" †" if c.contradicted else ""),
            _both(c.run.first.rho, c.paper_value("rho"), "+.1%"),
            "-" if c.spread is None else bounds(c.spread, "+.1%"),
            _both(c.run.first.valid_rate, c.paper_value("valid_pair_rate"), ".3f"),
            f"{c.site} / {c.paper_site}",
            c.run.training.loss,
            departures(c.run.training),
        )
        for c in differing
    )
    if not report.sites:
        notes = _nothing(report)
    elif not differing:
        notes = (f"None of the {len(report.sites)} runs that have a row in the paper differs from it.",)
    else:
        notes = (f"{len(differing)} of {len(report.sites)} runs that have a row in the paper differ from it.",)
        if any(c.contradicted for c in differing):
            notes += ("† printed numbers of this row contradict each other, see the details",)
    return Table("Runs at another site, or outside the spread of its seeds (ours / paper)", columns, lines, notes=notes)


def _site_line(c: SiteComparison) -> tuple[str | Cell, ...]:
    s = c.run.first
    no = Cell("NO")
    # A run at another site whose rho could be one more of the paper's seeds does not disagree with them.
    different = "no" if c.within_spread else no
    return (
        c.run.name,
        c.paper_name + (" †" if c.contradicted else ""),
        _both(s.valid_rate, c.paper_value("valid_pair_rate"), ".3f"),
        _both(s.rho, c.paper_value("rho"), "+.1%"),
        "-" if c.spread is None else bounds(c.spread, "+.1%"),
        "-" if c.within_spread is None else "yes" if c.within_spread else no,
        _both(c.run.residual_mm, c.paper_value("residual_mm"), ".1f"),
        departures(c.run.training),
        c.run.training.loss,
        f"{c.site} / {c.paper_site}",
        "-" if c.agrees is None else "yes" if c.agrees else different,
    )


def _notes(sites: tuple[SiteComparison, ...]) -> list[str]:
    notes = []
    assigned, spread = ([c for c in sites if getattr(c, name) is not None] for name in ("agrees", "within_spread"))
    same, inside = sum(c.agrees is True for c in assigned), sum(c.within_spread is True for c in spread)
    if assigned:
        notes.append(f"{same} of {len(assigned)} runs whose row the paper assigns a site lie there")
    if spread:
        notes.append(f"{inside} of {len(spread)} runs whose row has several seeds in the paper lie within their spread")
    alike = sum(departures(c.run.training) == NOTHING for c in sites)
    notes.append(
        f"{alike} of {len(sites)} runs were trained as the paper's in all that is known (network, noise, padding, "
        "learning rate, batch size, steps); a page says in what each departs"
    )
    notes += [
        f"not {c.run.name} (loss {c.run.training.loss}): {_site(c.site)}, where the paper has {_site(c.paper_site)}"
        + (", though within the spread of its seeds" if c.within_spread else "")
        for c in assigned
        if not c.agrees
    ]
    if any(c.contradicted for c in sites):
        notes.append("† printed numbers of this row contradict each other, see below")
    return notes


def contradictions_table(report: Report) -> Table | None:
    """What the paper prints about the rows that the runs touch and cannot be true together; None without any."""
    if not report.contradictions:
        return None
    columns = (Column("the paper's row", text=True), Column("its printed numbers", text=True))
    note = "computed from the printed figures by the functions that give ours; rounding alone never makes one"
    return Table("Where the paper's own numbers contradict each other", columns, report.contradictions, notes=(note,))


def comparisons_table(report: Report) -> Table:
    """Ours and the paper's, one line a quantity."""
    contradicted = {row for row, _ in report.contradictions}
    lines = []
    for c in report.comparisons:
        spec = ".1f" if c.quantity == "residual_mm" else ".4f"
        lines.append(
            (
                c.label,
                c.row + (" †" if c.row in contradicted else ""),
                c.source,
                c.quantity,
                c.loss,
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
        LOSS,
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
        Column("seeds", "training seeds behind the grade: how many, and which", text=True),
        LOSS,
        Column("evidence", text=True),
        Column("criterion", text=True, detail=True),
    )
    lines = tuple((g.claim, g.grade, g.seeds or "-", g.loss or "-", g.evidence, g.criterion) for g in report.claims)
    notes = ("Graded at the operating point of this report; the paper's claims are about the reference point.",)
    return Table("The paper's claims on these runs", columns, lines, notes=notes if report.reference_only else ())


def _nothing(report: Report) -> tuple[str, ...]:
    return (report.reference_only or NO_ROW,)


def _both(ours: float | None, paper: float | None, spec: str) -> str:
    return f"{number(ours, spec)} / {number(paper, spec)}"


def _site(numeral: str) -> str:
    return f"{SITE_NAMES[numeral]} {numeral}" if numeral in ("I", "II", "III", "IV") else SITE_NAMES[numeral]


def _site_names() -> str:
    return ", ".join(f"{numeral} {name}" for numeral, name in SITE_NAMES.items() if numeral not in "-?")
