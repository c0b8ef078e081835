"""The claims of tab:claims, graded on whatever runs are given."""

from dualhead_eval.paper.claims.claims import grade_claims
from dualhead_eval.paper.claims.grade import Grade

__all__ = ["Grade", "grade_claims"]
