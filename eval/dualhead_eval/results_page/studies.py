"""The studies of ``studies/`` that have results: cells beside the paper and the optimum, and criteria graded."""

from __future__ import annotations

from pathlib import Path

from dualhead_eval.report.table import Cell, Table
from dualhead_eval.results_page.template import markdown_table
from dualhead_eval.studies.closed_loop_store import ClosedLoopStore
from dualhead_eval.studies.closed_loop_table import closed_loop_table
from dualhead_eval.studies.gate_store import GateStore
from dualhead_eval.studies.grading import grade_study
from dualhead_eval.studies.residual_table import residual_table
from dualhead_eval.studies.sensitivity_table import sensitivity_table
from dualhead_eval.studies.study import FIGURE_FILE, OPTIMA, StudyFolders
from dualhead_eval.studies.study_cells import study_cells
from dualhead_eval.studies.study_file import read_study
from dualhead_eval.studies.study_plan import plan_study
from dualhead_eval.studies.study_references import StudyReferences
from dualhead_eval.studies.study_verdict import cells_table, grades_table
from dualhead_eval.studies.third_head_table import third_head_table

STUDIES = Path("studies")
RESULTS = Path("results") / "studies"
NOTHING = "No gate file of a study is committed yet: `dualhead study NAME` makes them."


def study_sections(arguments: list[str]) -> str:
    """``studies``: a section for every study of which a gate file is there.

    Raises:
        ValueError: If a study or a gate file is damaged, or a gate is not what its study asks for.
    """
    if arguments:
        raise ValueError(f"the studies take no arguments, {' '.join(arguments)!r} was given")
    sections = [_section(path) for path in sorted(STUDIES.glob("*.yaml"))]
    return "\n\n".join(section for section in sections if section) or NOTHING


def _section(path: Path) -> str:
    study = read_study(path)
    plan = plan_study(study)
    folders = StudyFolders(RESULTS, path.stem)
    store = GateStore(folders.gates)
    cells = study_cells(plan, store.results(plan))
    if not cells:
        return ""
    references = StudyReferences([folders.references, OPTIMA])
    cell_lines = cells_table(cells, references, study.title)
    loops = ClosedLoopStore(folders.closed_loops).results(plan)
    grade_lines = grades_table(grade_study(study, cells, references.rho, loops), study.question)
    done = len(plan.evaluations) - len(store.missing(plan))
    parts = [
        f"### {study.title}",
        study.question,
        f"    dualhead study {path.stem} --verdict-only",
        f"{done} of {len(plan.evaluations)} evaluations are there. {cell_lines.scope}.",
        _markdown(cell_lines),
        _markdown(grade_lines),
    ]
    if (driven := closed_loop_table(loops)) is not None:
        parts += [f"{driven.title} ({driven.scope}):", _markdown(driven)]
    if (scanned := sensitivity_table(cells)) is not None:
        parts += [f"{scanned.title} ({scanned.scope}):", _markdown(scanned)]
    if (third := third_head_table(cells)) is not None:
        parts += [f"{third.title} ({third.scope}):", _markdown(third)]
    if (residuals := residual_table(cells)) is not None:
        parts += [f"{residuals.title} ({residuals.scope}):", _markdown(residuals)]
    if grade_lines.notes:
        parts.append("\n".join(f"- {note}" for note in grade_lines.notes))
    figure = folders.own / FIGURE_FILE
    if figure.is_file():
        parts.append(f"![{study.title}](../{figure.as_posix()})")
    return "\n\n".join(parts)


def _markdown(table: Table) -> str:
    rows = [[cell.text if isinstance(cell, Cell) else cell for cell in row] for row in table.rows]
    return markdown_table([column.name for column in table.columns], rows)
