"""A study's verdict as tables: its cells beside the paper and the exact reference, and its criteria graded."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.paper.claims.grade import FAILS, HOLDS
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.report.table import LOSS, RHO, Cell, Column, Table
from dualhead_eval.studies.grading.grade import StudyGrade, points
from dualhead_eval.studies.grading.printed_cells import printed_number
from dualhead_eval.studies.study_cells import StudyCell
from dualhead_eval.studies.study_references import StudyReferences

CELL_COLUMNS = (
    Column("cell", "DATASET/CONFIGURATION-BUDGET, with the step of a checkpoint on the way", text=True),
    Column("seeds", "seeds that are there and can be read, of those that the study asks for"),
    Column("valid", "share of sampled pairs in which both heads reach a mode; no rho is read without it"),
    Column(f"{RHO} %", "mean over seeds, with the 95% t interval of the mean over seeds"),
    Column("paper %", "the paper's row: tab:main, tab:v3, tab:maps, tab:toy-corner"),
    Column(
        "exact %",
        "the optimum of the same loss under the same conditions; \N{ALMOST EQUAL TO} an approximate one, (n) under the "
        "first n conditions",
    ),
    Column("C", "how much the heads could coordinate; 1 - 1/K is everything"),
    Column("C, paper", "the paper's; of tab:collapse's cells C / max C"),
    Column("\N{GREEK CAPITAL LETTER DELTA}", "how much more often than chance the heads choose one mode"),
    LOSS,
)
GRADE_COLUMNS = (
    Column("criterion", text=True),
    Column("grade", text=True),
    Column("claim", text=True),
    Column("evidence", text=True),
)


def cells_table(cells: Sequence[StudyCell], references: StudyReferences, title: str) -> Table:
    """One line per cell."""
    conditions = {(cell.dataset, cell.bank): cell.runs[0].gate.n_conditions for cell in cells}
    scope = "; ".join(f"{dataset}, bank {bank}: {n} conditions" for (dataset, bank), n in conditions.items())
    return Table(title, CELL_COLUMNS, tuple(_cell_line(cell, references) for cell in cells), scope=scope)


def _cell_line(cell: StudyCell, references: StudyReferences) -> tuple[str | Cell, ...]:
    printed = paper_row(cell.paper_row)
    theirs, capacity = (printed[name].value if name in printed else None for name in ("rho", "C"))
    collapse = printed_number(cell.runs[0].gate, "tab:collapse", "C_rel")
    seeds = f"{len(cell.read)}/{len(cell.planned)}"
    rho = cell.mean("rho")
    values = [run.first for run in cell.runs]
    return (
        cell.name if cell.bank == "frozen" else f"{cell.name} ({cell.bank})",
        seeds if len(cell.read) == len(cell.planned) else Cell(seeds),
        f"{sum(value.valid_rate for value in values) / len(values):.3f}",
        "undefined" if rho != rho else points(rho, cell.interval()),
        "-" if theirs is None else points(theirs),
        _exact(cell, references),
        f"{sum(value.capacity for value in values) / len(values):.3f}",
        f"{capacity:.3f}" if capacity is not None else f"{collapse:.3f} max" if collapse is not None else "-",
        f"{sum(value.delta for value in values) / len(values):+.3f}",
        cell.loss,
    )


def _exact(cell: StudyCell, references: StudyReferences) -> str:
    found = references.find(cell)
    if found is None:
        return "-"
    mark = "\N{ALMOST EQUAL TO} " if found.approximate else ""
    some = "" if found.n_conditions == cell.runs[0].gate.n_conditions else f" ({found.n_conditions})"
    return f"{mark}{points(found.rho)}{some}"


def grades_table(grades: Sequence[StudyGrade], title: str) -> Table:
    """One line per criterion; what is short is named beneath."""
    lines: list[tuple[str | Cell, ...]] = [
        (
            grade.name.replace("-", " "),
            grade.grade if grade.grade == HOLDS else Cell(grade.grade),
            grade.claim,
            grade.evidence,
        )
        for grade in grades
    ]
    notes = tuple(f"{grade.name}, short: {'; '.join(grade.shortage)}" for grade in grades if grade.shortage)
    legend = (
        (HOLDS, "every cell meets the criterion that the study's file fixes"),
        (FAILS, "one cell or more is outside it; the evidence names them"),
    )
    return Table(title, GRADE_COLUMNS, tuple(lines), notes=notes, legend=legend)
