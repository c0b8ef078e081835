"""The claim that a token which both heads follow takes robot policies to the high-capacity corner."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED, Grade, Measured, grade_of

CLAIM = "Partition tokens reach the high-capacity corner on the robots"
CRITERION = "every token run at rho >= 85% and C >= 0.80 max C"


def grade_tokens(measured: Sequence[Measured]) -> Grade:
    """Sites of the robot runs whose heads share one token; controls in which each head draws its own are left out."""
    chosen = [m for m in measured if m.robot and m.mechanism.token]
    if not chosen:
        return Grade(CLAIM, UNGRADED, "no robot run with a shared token", CRITERION)
    reached = [m for m in chosen if m.run.first.occupancy is Occupancy.CORNER]
    evidence = f"{len(reached)} of {len(chosen)} runs in the corner: "
    evidence += ", ".join(f"{m.run.name} {m.run.first.rho:+.1%}" for m in chosen)
    grade = HOLDS if len(reached) == len(chosen) else OPEN if reached else FAILS
    return grade_of(CLAIM, grade, evidence, CRITERION, chosen)
