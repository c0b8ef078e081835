"""One study from its file to its verdict: work that is missing, gates held against what was asked, table, figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dualhead_eval.atomic_text import write_text
from dualhead_eval.studies.closed_loop_store import ClosedLoopStore, LoopResult
from dualhead_eval.studies.gate_store import GateStore
from dualhead_eval.studies.grading import StudyGrade, grade_study
from dualhead_eval.studies.study_cells import StudyCell, study_cells
from dualhead_eval.studies.study_file import StudyFile
from dualhead_eval.studies.study_plan import StudyEvaluation, StudyLoop, StudyPlan
from dualhead_eval.studies.study_references import StudyReferences, write_missing_references
from dualhead_eval.studies.study_table import csv_text, study_rows

#: What a study writes into its folder.
TABLE_FILE, FIGURE_FILE = "table.csv", "figure.png"
#: Where the numerical optima are committed.
OPTIMA = Path("results") / "optimum"


@dataclass(frozen=True)
class StudyFolders:
    """Where a study's results lie.

    Attributes:
        results: Folder of all studies' results: ``gates``, ``closed_loops``, ``references``, and a folder per study.
        name: The study's name.
    """

    results: Path
    name: str

    @property
    def gates(self) -> Path:
        """Gate files, shared by all studies."""
        return self.results / "gates"

    @property
    def closed_loops(self) -> Path:
        """Outcomes of closed loops, shared by all studies."""
        return self.results / "closed_loops"

    @property
    def references(self) -> Path:
        """Exact references, shared by all studies."""
        return self.results / "references"

    @property
    def own(self) -> Path:
        """Table and figure of this study."""
        return self.results / self.name


@dataclass(frozen=True)
class StudyVerdict:
    """What a study shows.

    Attributes:
        cells: Its cells, as far as there are gates.
        grades: Its criteria.
        missing: Evaluations without a gate file.
        loops: Its closed loops, as far as they are there.
        missing_loops: Closed loops without outcomes.
        references: The exact references at hand.
        table, figure: Its files; None where no gate is there, and no figure where no seed can be read.
    """

    cells: list[StudyCell]
    grades: list[StudyGrade]
    missing: list[StudyEvaluation]
    loops: list[LoopResult]
    missing_loops: list[StudyLoop]
    references: StudyReferences
    table: Path | None
    figure: Path | None


def judge_study(study: StudyFile, plan: StudyPlan, folders: StudyFolders, data: Path) -> StudyVerdict:
    """Read what gates there are, and say what they show; files that would not change are not written again.

    Args:
        study: The study.
        plan: Its plan.
        folders: Where its results lie.
        data: Folder of the datasets, for references that are missing; need not exist.

    Raises:
        ValueError: If a gate file, or a closed loop's, is damaged or not what the study asks for.
    """
    store, loop_store = GateStore(folders.gates), ClosedLoopStore(folders.closed_loops)
    missing, loops = store.missing(plan), loop_store.results(plan)
    cells = study_cells(plan, store.results(plan))
    write_missing_references(plan, data, folders.references)
    references = StudyReferences([folders.references, OPTIMA])
    grades = grade_study(study, cells, references.rho, loops)
    table = figure = None
    if cells:
        table = folders.own / TABLE_FILE
        changed = _replace(table, csv_text(study_rows(cells, references)))
        # Where no seed can be read there is nothing to draw.
        if any(cell.read for cell in cells):
            figure = folders.own / FIGURE_FILE
            if changed or not figure.is_file():
                from dualhead_eval.studies.study_figure import draw_study

                draw_study(cells, references, figure, study.figure)
    return StudyVerdict(cells, grades, missing, loops, loop_store.missing(plan), references, table, figure)


def missing_lines(missing: Sequence[StudyEvaluation], loops: Sequence[StudyLoop] = ()) -> list[str]:
    """One line per cell that lacks gate files or closed loops: the seeds, and the files that each lacks."""
    by_run: dict[tuple[str, int], list[str]] = {}
    lacking = [(one.run, one.gate_file.name) for one in missing] + [(one.run, one.file.name) for one in loops]
    for run, file in lacking:
        by_run.setdefault((run.cell, run.seed), []).append(file)
    alike: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for (cell, seed), files in by_run.items():
        alike.setdefault((cell, tuple(files)), []).append(seed)
    return [
        f"missing {cell}, seed {', '.join(map(str, sorted(seeds)))}: {', '.join(files)}"
        for (cell, files), seeds in alike.items()
    ]


def _replace(path: Path, text: str) -> bool:
    """Write a file unless it holds the text already; whether it was written."""
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return False
    write_text(path, text)
    return True
