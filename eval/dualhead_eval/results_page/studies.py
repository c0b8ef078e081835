"""The studies of ``studies/`` that have results: cells beside the paper and the optimum, and criteria graded."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.report.table import Cell, Table
from dualhead_eval.results_page.graded_studies import GradedStudy
from dualhead_eval.results_page.template import markdown_table
from dualhead_eval.studies.closed_loop_table import closed_loop_table
from dualhead_eval.studies.residual_table import residual_table
from dualhead_eval.studies.sensitivity_table import sensitivity_table
from dualhead_eval.studies.study import FIGURE_FILE
from dualhead_eval.studies.study_verdict import cells_table, grades_table
from dualhead_eval.studies.third_head_table import third_head_table

NOTHING = "No gate file of a study is committed yet: `dualhead study NAME` makes them."


def study_sections(studies: Sequence[GradedStudy]) -> str:
    """``studies``: a section for each."""
    return "\n\n".join(map(_section, studies)) or NOTHING


def _section(graded: GradedStudy) -> str:
    study, cells = graded.study, graded.cells
    cell_lines = cells_table(cells, graded.references, study.title)
    grade_lines = grades_table(graded.grades, study.question)
    parts = [
        f"### {study.title}",
        study.question,
        f"    dualhead study {graded.name} --verdict-only",
        f"{graded.done} of {graded.planned} evaluations are there. {cell_lines.scope}.",
        _markdown(cell_lines),
        _markdown(grade_lines),
    ]
    if (driven := closed_loop_table(graded.loops)) is not None:
        parts += [f"{driven.title} ({driven.scope}):", _markdown(driven)]
    if (scanned := sensitivity_table(cells)) is not None:
        parts += [f"{scanned.title} ({scanned.scope}):", _markdown(scanned)]
    if (third := third_head_table(cells)) is not None:
        parts += [f"{third.title} ({third.scope}):", _markdown(third)]
    if (residuals := residual_table(cells)) is not None:
        parts += [f"{residuals.title} ({residuals.scope}):", _markdown(residuals)]
    if grade_lines.notes:
        parts.append("\n".join(f"- {note}" for note in grade_lines.notes))
    figure = graded.folders.own / FIGURE_FILE
    if figure.is_file():
        parts.append(f"![{study.title}](../{figure.as_posix()})")
    return "\n\n".join(parts)


def _markdown(table: Table) -> str:
    rows = [[cell.text if isinstance(cell, Cell) else cell for cell in row] for row in table.rows]
    return markdown_table([column.name for column in table.columns], rows)
