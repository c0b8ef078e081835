"""Success in closed loop, over all episodes and over those of every way."""

from __future__ import annotations

from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN
from dualhead_eval.studies.closed_loop_store import LoopResult
from dualhead_eval.studies.closed_loop_table import shown_success
from dualhead_eval.studies.criterion import ClosedLoopCriterion
from dualhead_eval.studies.grading.grade import CellGrade


def grade_closed_loop(result: LoopResult, criterion: ClosedLoopCriterion) -> CellGrade:
    """Wilson's lower ends against their bounds; a way that no episode took is not driven.

    Inconclusive where an interval holds its bound: more episodes would tell.
    """
    outcome = result.outcome
    ways = [way for way in outcome.modes if way.mode >= 0]
    checked = [(outcome.success_interval, criterion.at_least)]
    checked += [(way.success_interval, criterion.each_way_at_least) for way in ways]
    if any(not way.episodes for way in ways) or any(interval.high < bound for interval, bound in checked):
        grade = FAILS
    else:
        grade = HOLDS if all(interval.low >= bound for interval, bound in checked) else OPEN
    least = min(ways, key=lambda way: way.success_interval.low if way.episodes else -1.0)
    taken = shown_success(least.successes, least.episodes) if least.episodes else "never taken"
    shown = f"success {shown_success(outcome.successes, outcome.episodes)}, least by way {least.mode}: {taken}"
    return CellGrade(result.name, grade, shown)
