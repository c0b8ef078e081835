"""The demo's table: one line per coupling, beside the exact reference, with what each line means."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from dualhead_eval.gate import Gate
from dualhead_eval.report.table import LOSS, RHO
from dualhead_eval.statistics.run_summary import RunSummary, summarise_run
from dualhead_eval.statistics.training_record import training_record
from dualhead_eval.studies.plan import PlannedRow

Result = tuple[PlannedRow, Gate, Gate | None]

COLUMNS = (
    (
        "valid",
        "share of sampled pairs in which both heads reach a mode (a ring row below 0.95 is not readable)",
    ),
    ("C", "how much the heads could coordinate given how varied each is; 0.5 is everything with two modes"),
    ("Δ", "how much more often than chance they choose the same mode; negative: less often"),
    (RHO, "Δ / C, with its 95% interval over the test conditions: 0 independent, 1 always together"),
    (f"exact {RHO}", "the same for the best possible network, in closed form; ≈ marks an approximation"),
)


def story_table(results: Sequence[Result]) -> Group:
    """The table and its legend."""
    table = Table(title="One motion, two heads: do they choose the same way?", title_justify="left", pad_edge=False)
    table.add_column("what the heads share", min_width=15)
    known = any(reference is not None for _, _, reference in results)
    for name in ("valid", "C", "Δ", f"{RHO} [95% interval]", *([f"exact {RHO}"] if known else []), "loss"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("what it shows", min_width=30, overflow="fold")
    for row, trained, reference in results:
        line = summarise_run(trained)
        exact = [_exact(reference)] if known else []
        loss = training_record(trained).loss
        table.add_row(row.title, *_numbers(line), *exact, loss, _story(row, line), end_section=True)
    legend = Table.grid(padding=(0, 2))
    legend.add_column(no_wrap=True, style="bold")
    legend.add_column()
    for name, meaning in [*(COLUMNS if known else COLUMNS[:-1]), (LOSS.name, LOSS.meaning)]:
        legend.add_row(name, meaning)
    return Group(table, legend)


def _numbers(summary: RunSummary) -> list[str]:
    interval = summary.intervals["rho"]
    rho = "undefined"
    if summary.rho == summary.rho:
        rho = f"{summary.rho:+.1%} [{interval.low:+.1%}, {interval.high:+.1%}]"
    return [f"{summary.valid_rate:.3f}", f"{summary.capacity:.3f}", f"{summary.delta:+.3f}", rho]


def _exact(reference: Gate | None) -> str:
    if reference is None:
        return "none"
    rho = summarise_run(reference).rho
    mark = "≈ " if "approximate" in reference.provenance["method"] else ""
    return f"{mark}{rho:+.1%}"


def _story(row: PlannedRow, line: RunSummary) -> Text:
    if line.readable:
        return Text(row.story)
    return Text(
        f"Not yet readable: only {line.valid_rate:.0%} of pairs are valid, so train longer "
        "(--preset full) before reading this row.",
        style="bold yellow",
    )
