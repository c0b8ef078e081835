"""The paper's claims on the page of results: every criterion exists, and its grade stands under its claim."""

from pathlib import Path

import pytest

from dualhead_eval.paper.claims.grade import FAILS, HOLDS
from dualhead_eval.results_page.claims import CLAIMS, COLUMNS, claims_table
from dualhead_eval.results_page.graded_studies import GradedStudy
from dualhead_eval.statistics.run import open_run
from dualhead_eval.studies.grading import CellGrade, StudyGrade
from dualhead_eval.studies.study import StudyFolders
from dualhead_eval.studies.study_cells import StudyCell
from dualhead_eval.studies.study_file import read_study
from dualhead_eval.studies.study_references import StudyReferences

STUDIES = Path(__file__).parents[3] / "studies"


@pytest.fixture
def graded(make_gate):
    """Builds a study with one gate and the criteria that are given, by name."""

    def build(name, **grades):
        cell = StudyCell("ring", "A", 1000, 1000, "frozen", (), (open_run(make_gate("A", conditions=20)),), (0,))
        made = [
            StudyGrade(one.replace("_", "-"), f"claim of {one}", "when", grade, cells, shortage)
            for one, (grade, cells, shortage) in grades.items()
        ]
        folders = StudyFolders(Path("results"), name)
        return GradedStudy(name, None, folders, [cell], StudyReferences([]), [], made, 1, 1)

    return build


def test_every_criterion_that_judges_a_claim_is_in_its_study():
    named = [one for claim in CLAIMS for one in claim.criteria]
    assert len(set(named)) == len(named)
    for one in named:
        study, _, criterion = one.partition("/")
        assert criterion in {own.name for own in read_study(STUDIES / f"{study}.yaml").criteria}, one


def test_a_criterion_stands_under_its_claim_with_its_cells_and_what_is_short(graded):
    cells = (CellGrade("v2/A", HOLDS, ""), CellGrade("v2/B", FAILS, ""))
    consistency = {"consistency": (FAILS, cells, ()), "consistency_paper_budget": (HOLDS, cells[:1], ("v2/C: no run",))}
    study = graded("v2-atlas", **consistency, **dict.fromkeys(_others("v2-atlas"), (HOLDS, cells[:1], ())))
    lines = [line.strip("| ").split(" | ") for line in claims_table([study]).splitlines()]
    assert lines[0] == COLUMNS
    bound = lines[2]
    assert "0 of 80 tables outside the bounds" in bound  # four operating points
    (first,) = (line for line in lines if "claim of consistency" in line)
    assert first[0].startswith("Endpoint consistency coordinates")
    assert first[1:] == ["`v2-atlas`, consistency", "claim of consistency", "1 of 2", f"**{FAILS}**"]
    (second,) = (line for line in lines if "claim of consistency_paper_budget" in line)
    assert second[-2:] == ["1 of 1, 1 short", f"**{HOLDS}**"]


def test_a_criterion_that_a_study_no_longer_has_is_named(graded):
    with pytest.raises(ValueError, match="v3-atlas has no criterion 'floor', expected one of corner"):
        claims_table([graded("v3-atlas", corner=(HOLDS, (), ()))])


def _others(study):
    """The criteria of a study that judge claims, but those about consistency."""
    named = [one.partition("/") for claim in CLAIMS for one in claim.criteria]
    own = [criterion for name, _, criterion in named if name == study]
    return [criterion.replace("-", "_") for criterion in own if not criterion.startswith("consistency")]
