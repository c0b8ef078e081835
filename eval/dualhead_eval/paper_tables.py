"""The paper's numbers and claims beside ours, as terminal tables."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table

from dualhead_eval.claims import grade_claims
from dualhead_eval.gate import Gate
from dualhead_eval.paper_numbers import compare_with_paper
from dualhead_eval.report import Row


def render_comparisons(gates: Sequence[Gate], rows: Sequence[Row]) -> Table | str:
    """Ours and the paper's, one line a quantity; a sentence if no run has a row in the paper."""
    comparisons = compare_with_paper(gates, rows)
    if not comparisons:
        return "None of these runs has the setting of a row in the paper."
    table = Table(title="Beside the paper's numbers", title_justify="left", pad_edge=False)
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
    table = Table(title="The paper's claims on these runs", title_justify="left", pad_edge=False)
    table.add_column("claim", overflow="fold", ratio=3)
    table.add_column("grade", no_wrap=True)
    table.add_column("evidence", overflow="fold", ratio=4)
    for grade in grade_claims(gates):
        table.add_row(grade.claim, grade.grade, grade.evidence)
    return Group(table)
