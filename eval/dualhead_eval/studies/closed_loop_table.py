"""What became of a study's closed loops, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.evaluation.rollouts import wilson_interval
from dualhead_eval.report.table import Column, Table
from dualhead_eval.studies.closed_loop_store import LoopResult

COLUMNS = (
    Column("closed loop", "DATASET/CONFIGURATION-BUDGET and training seed", text=True),
    Column("driving head", "the head whose chunks are executed", text=True),
    Column("success %", "episodes that reach the goal without a collision, with Wilson's 95% interval"),
    Column("collisions", "episodes that end in one"),
    Column("successes by way", "way: successes of its episodes; none: episodes that took no way", text=True),
)


def closed_loop_table(results: Sequence[LoopResult]) -> Table | None:
    """One line per closed loop; None without any."""
    if not results:
        return None
    counts = sorted({result.outcome.episodes for result in results})
    scope = f"{' or '.join(map(str, counts))} episodes each, from initial states that no demonstration began from"
    return Table("Closed loop", COLUMNS, tuple(map(_line, results)), scope=scope)


def _line(result: LoopResult) -> tuple[str, ...]:
    outcome = result.outcome
    ways = ", ".join(
        f"{'none' if way.mode < 0 else way.mode}: {way.successes} of {way.episodes}"
        for way in outcome.modes
        if way.mode >= 0 or way.episodes
    )
    return (
        f"{result.loop.run.cell} seed {result.loop.run.seed}",
        outcome.control,
        shown_success(outcome.successes, outcome.episodes),
        f"{outcome.collisions} of {outcome.episodes}",
        ways,
    )


def shown_success(successes: int, episodes: int) -> str:
    """A success rate in percent, with Wilson's 95% interval."""
    interval = wilson_interval(successes, episodes)
    return f"{100 * successes / episodes:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
