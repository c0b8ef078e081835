"""Terminal tables beside the runs: means over seeds, the paper's numbers, its claims graded."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from dualhead_eval.gate.gate import Gate
from dualhead_eval.paper.claims import grade_claims
from dualhead_eval.paper.numbers import compare_with_paper
from dualhead_eval.report.content import RHO, Row
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.family_summary import family_rows
from dualhead_eval.statistics.head_agreement import all_heads_agreement


def render_comparisons(gates: Sequence[Gate], rows: Sequence[Row]) -> Table | str:
    """Ours and the paper's, one line a quantity; a sentence if no run has a row in the paper."""
    comparisons = compare_with_paper(gates, rows)
    if not comparisons:
        return "None of these runs has the setting of a row in the paper."
    table = Table(title="Beside the paper's numbers", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for name in ("run", "the paper's row", "quantity"):
        table.add_column(name, overflow="fold")
    for name in ("ours", "95% (conditions)", "paper", "difference", "seeds"):
        table.add_column(name, justify="right", no_wrap=True)
    for c in comparisons:
        spec = ".1f" if c.quantity == "residual_mm" else ".4f"
        interval = c.interval
        bounds = (
            ""
            if interval is None or interval.low != interval.low
            else (f"[{interval.low:{spec}}, {interval.high:{spec}}]")
        )
        ours, gap = ("undefined", "") if c.ours != c.ours else (f"{c.ours:{spec}}", f"{c.difference:+{spec}}")
        table.add_row(c.label, c.row, c.quantity, ours, bounds, f"{c.paper:{spec}}", gap, str(c.n or ""))
    return table


def render_claims(gates: Sequence[Gate]) -> Group:
    """The claims of tab:claims with their grades."""
    table = Table(title="The paper's claims on these runs", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("claim", overflow="fold", ratio=3)
    table.add_column("grade", no_wrap=True)
    table.add_column("evidence", overflow="fold", ratio=4)
    for grade in grade_claims(gates):
        table.add_row(grade.claim, grade.grade, grade.evidence)
    return Group(table)


def render_all_heads(gates: Sequence[Gate]) -> Table | None:
    """Runs with a third head: do all heads choose one mode, and how far apart are they? None without such a run."""
    chosen = [gate for gate in gates if len(gate.heads) > 2]
    if not chosen:
        return None
    table = Table(title="All heads at once", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("run", overflow="fold", min_width=12)
    table.add_column("heads", overflow="fold")
    for name in ("all valid", "in one mode", "by chance", "residuals (means)"):
        table.add_column(name, justify="right", no_wrap=True)
    for gate in chosen:
        agreement = all_heads_agreement(gate)
        low, high = agreement.interval.low, agreement.interval.high
        means = [
            f"{summarise_strata(strata.at(gate.index())).mean:.2f} {strata.unit}"
            for component, strata in gate.strata.items()
            if "/" not in component
        ]
        shares = [f"{agreement.valid_rate:.3f}", f"{agreement.rate:.3f} [{low:.3f},{high:.3f}]"]
        table.add_row(gate.label, ", ".join(gate.heads), *shares, f"{agreement.chance:.3f}", ", ".join(means))
    return table


def render_families(gates: Sequence[Gate], rows: Sequence[Row]) -> Table | None:
    """Means over seeds, the seed being the unit; None if no two gates are seeds of one mechanism."""
    families = family_rows(gates, rows)
    if not families:
        return None
    title = "Means over seeds (the seed is the unit)"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("family", overflow="fold", min_width=12)
    for name in ("seeds", "valid", "C", "Δ", f"{RHO}", "sd", "95% (t)"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column(f"{RHO} = 0?", no_wrap=True)
    table.add_column("reading", overflow="fold")
    for family in families:
        s, interval, test = family.summary, family.rho_interval, family.equivalence
        numbers = [f"{s.mean['valid_rate']:.3f}", f"{s.mean['capacity']:.4f}", f"{s.mean['delta']:+.4f}"]
        if interval is None or test is None:
            cells = ["undefined"] * 4
        else:
            bounds = f"[{100 * interval.low:+.1f},{100 * interval.high:+.1f}]"
            verdict = f"{'yes' if test.equivalent else 'no'} ±{test.width:.1%}"
            cells = [f"{s.mean['rho']:+.1%}", f"{s.sd['rho']:.1%}", bounds, verdict]
        reading = f"{s.occupancy.word} ({s.occupancy.site})"
        table.add_row(s.label, str(len(s.runs)), *numbers, *cells, reading)
    return table
