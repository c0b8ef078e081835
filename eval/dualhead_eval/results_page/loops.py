"""What became of recorded episodes, and which way they took."""

from __future__ import annotations

from dualhead_eval.evaluation.rollouts import wilson_interval
from dualhead_eval.results_page.folders import closed_loops
from dualhead_eval.results_page.template import markdown_table
from dualhead_eval.statistics.interval import Interval


def closed_loop_table(arguments: list[str]) -> str:
    """``closed_loop FOLDER``: success of every recording, and the share of its episodes by mode, with Wilson intervals.

    Raises:
        ValueError: If not one folder is named, or it holds no outcomes.
    """
    if len(arguments) != 1:
        raise ValueError(f"{len(arguments)} folders are named, expected one with *.rollouts.json files")
    loops = closed_loops(arguments[0])
    if not loops:
        raise ValueError(f"{arguments[0]} holds no *.rollouts.json, expected one or more")
    rows = []
    for name, loop in loops:
        ways = ", ".join(
            f"{'none' if outcome.mode < 0 else outcome.mode}: "
            + _share(outcome.episodes, loop.episodes, wilson_interval(outcome.episodes, loop.episodes))
            for outcome in loop.modes
            if outcome.mode >= 0 or outcome.episodes
        )
        success = _share(loop.successes, loop.episodes, loop.success_interval)
        rows.append([name, loop.control, success, f"{loop.collisions}", ways])
    return markdown_table(["recording", "driving head", "success", "collisions", "episodes by mode"], rows)


def _share(part: int, whole: int, interval: Interval) -> str:
    return f"{part} of {whole} = {100 * part / whole:.0f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
