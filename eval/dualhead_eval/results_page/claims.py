"""The claims of tab:claims over seeds and conditions: which criteria of the studies judge each, and their grades."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dualhead_eval.paper.claims.bound import grade_bound
from dualhead_eval.paper.claims.grade import HOLDS
from dualhead_eval.results_page.graded_studies import GradedStudy
from dualhead_eval.results_page.template import markdown_table
from dualhead_eval.studies.grading import StudyGrade

COLUMNS = ["claim of the paper, and its status there", "criterion", "what it asks", "cells that hold", "grade"]


@dataclass(frozen=True)
class Claim:
    """A claim of tab:claims.

    Attributes:
        claim: What it says.
        status: The paper's label for its evidence.
        criteria: ``STUDY/CRITERION`` of every criterion that judges it.
    """

    claim: str
    status: str
    criteria: tuple[str, ...]


BOUND = "The effect lies within the capacity in every condition"
#: In the paper's order, the bound before them. Its last four claims, about monitors, are judged by the monitor studies.
CLAIMS = (
    Claim(
        "An auxiliary latent outside the construction leaves the heads uncoordinated",
        "finite-model equivalence",
        ("v2-atlas/floor", "v3-atlas/floor", "ring-factorial/floor", "ring-modes/floor", "ring-priors/floor"),
    ),
    Claim(
        "What shared source noise does depends on the representation map",
        "confirmed",
        ("ring-factorial/interaction", "ring-maps/law", "noise-alignment/gain"),
    ),
    Claim(
        "On the robots its sign is the training seed's",
        "seed-unstable",
        ("v2-atlas/shared-noise-sign", "v3-atlas/shared-noise-sign", "third-way/shared-noise-sign"),
    ),
    Claim(
        "Endpoint consistency coordinates without a partition, at a cost in valid pairs",
        "supported in the tested regimes",
        (
            "v2-atlas/consistency",
            "v2-atlas/consistency-paper-budget",
            "v3-atlas/consistency",
            "v3-atlas/consistency-paper-budget",
            "third-way/consistency",
            "v2-atlas/ladder",
            "ring-factorial/ladder",
            "ring-priors/consistency",
            "ring-priors/consistency-keeps-modes",
            "budget/G-default-constant",
            "budget/G-paper-network",
        ),
    ),
    Claim(
        "Partition tokens reach the robot's high-capacity corner",
        "a sufficient route",
        ("v2-atlas/corner", "v3-atlas/corner", "third-way/corner"),
    ),
    Claim(
        "An amortised posterior keeps both modes on the balanced ring, and collapses on the robot",
        "supported",
        ("ring-collapse/collapse-at-skew", "v2-atlas/posterior"),
    ),
)


def claims_table(studies: Sequence[GradedStudy]) -> str:
    """``claims``: a line for every criterion of a study that is there, under the claim that it judges.

    Raises:
        ValueError: If a study lacks a criterion that is named here.
    """
    by_name = {study.name: study for study in studies}
    runs = [run for study in studies for cell in study.cells for run in cell.runs]
    bound = grade_bound(runs)
    rows = [[f"{BOUND} (an identity)", "every gate", bound.criterion, bound.evidence, _shown(bound.grade)]]
    for claim in CLAIMS:
        first = f"{claim.claim} ({claim.status})"
        for named in claim.criteria:
            study, _, criterion = named.partition("/")
            if study not in by_name:
                continue
            grade = _criterion(by_name[study], criterion)
            rows.append(
                [first, f"`{study}`, {criterion.replace('-', ' ')}", grade.claim, _cells(grade), _shown(grade.grade)]
            )
            first = ""
    return markdown_table(COLUMNS, rows)


def _criterion(study: GradedStudy, name: str) -> StudyGrade:
    for grade in study.grades:
        if grade.name == name:
            return grade
    names = ", ".join(grade.name for grade in study.grades)
    raise ValueError(f"the study {study.name} has no criterion {name!r}, expected one of {names}")


def _cells(grade: StudyGrade) -> str:
    held = sum(cell.grade == HOLDS for cell in grade.cells)
    short = f", {len(grade.shortage)} short" if grade.shortage else ""
    return f"{held} of {len(grade.cells)}{short}"


def _shown(grade: str) -> str:
    return f"**{grade}**"
