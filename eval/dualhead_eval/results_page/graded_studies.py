"""The studies of ``studies/`` as the committed gate files leave them: read and graded once for a page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dualhead_eval.studies.closed_loop_store import ClosedLoopStore, LoopResult
from dualhead_eval.studies.gate_store import GateStore
from dualhead_eval.studies.grading import StudyGrade, grade_study
from dualhead_eval.studies.study import OPTIMA, StudyFolders
from dualhead_eval.studies.study_cells import StudyCell, study_cells
from dualhead_eval.studies.study_file import StudyFile, read_study
from dualhead_eval.studies.study_plan import plan_study
from dualhead_eval.studies.study_references import StudyReferences

STUDIES = Path("studies")
RESULTS = Path("results") / "studies"


@dataclass(frozen=True)
class GradedStudy:
    """A study of which a gate file is there.

    Attributes:
        name: Its file's name.
        study: Its file.
        folders: Where its results lie.
        cells: What is there, at least one.
        references: Exact references and optima.
        loops: Closed loops.
        grades: Its criteria, graded, in the file's order.
        done, planned: Evaluations that are there, and that it asks for.
    """

    name: str
    study: StudyFile
    folders: StudyFolders
    cells: list[StudyCell]
    references: StudyReferences
    loops: list[LoopResult]
    grades: list[StudyGrade]
    done: int
    planned: int


def graded_studies() -> list[GradedStudy]:
    """Every study of which a gate file is there, by name.

    Raises:
        ValueError: If a study or a gate file is damaged, or a gate is not what its study asks for.
    """
    shared = StudyFolders(RESULTS, "")  # gates, references and closed loops are those of all studies
    store, closed_loops = GateStore(shared.gates), ClosedLoopStore(shared.closed_loops)
    references = StudyReferences([shared.references, OPTIMA])
    found = []
    for path in sorted(STUDIES.glob("*.yaml")):
        study = read_study(path)
        plan = plan_study(study)
        cells = study_cells(plan, store.results(plan))
        if not cells:
            continue
        loops = closed_loops.results(plan)
        grades = grade_study(study, cells, references.rho, loops)
        done, folders = len(plan.evaluations) - len(store.missing(plan)), StudyFolders(RESULTS, path.stem)
        found.append(
            GradedStudy(path.stem, study, folders, cells, references, loops, grades, done, len(plan.evaluations))
        )
    return found
