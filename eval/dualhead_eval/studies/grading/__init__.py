"""Criteria of a study, graded on its cells."""

from dualhead_eval.studies.grading.grade import CellGrade, StudyGrade
from dualhead_eval.studies.grading.grading import grade_study

__all__ = ["CellGrade", "StudyGrade", "grade_study"]
