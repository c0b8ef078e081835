"""The sweep's tables, as plain cells for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.report.table import Cell as Marked
from dualhead_eval.report.table import Column, Table, with_bounds
from dualhead_eval.studies.monitor.regimes.definition import RegimeSweep
from dualhead_eval.studies.monitor.regimes.grading import Graded, passes
from dualhead_eval.studies.monitor.regimes.outcome import Estimate
from dualhead_eval.studies.monitor.regimes.sweep import Result, Swept
from dualhead_eval.studies.monitor.registration import Gate
from dualhead_eval.studies.monitor.verdicts import MET


def regime_tables(sweep: RegimeSweep, swept: Swept, graded: Sequence[Graded], gate: Gate) -> list[Table]:
    """Criteria; the gap without tokens; what coordination takes away."""
    return [_criteria(graded), _without_token(sweep, swept), _taken_away(sweep, swept, gate)]


def _criteria(graded: Sequence[Graded]) -> Table:
    columns = (
        Column("criterion", text=True),
        Column("asked", text=True),
        Column("grade", text=True),
        Column("found", "points are percentage points of false alarms", text=True),
    )
    rows = tuple((one.name, one.asked, one.grade if one.grade == MET else Marked(one.grade), one.found)
                 for one in graded)  # fmt: skip
    return Table("The registered criteria", columns, rows, "docs/monitor_registration.md")


def _without_token(sweep: RegimeSweep, swept: Swept) -> Table:
    columns = (
        Column("f"),
        Column("prior"),
        *(Column(f"separation {one:g}", _GAP if not i else "") for i, one in enumerate(sweep.axes.separation)),
    )
    rows = []
    for share in sweep.flagged_shares:
        for prior in sweep.axes.prior:
            found = [
                one
                for one in swept.grid
                if one.arm == "none" and one.flagged_share == share and one.cell.prior == prior
            ]
            rows.append((f"{share:g}", f"{prior:g}", *(_beside(one.found.gap, one.predicted.gap) for one in found)))
    return Table("Gap of false alarms without token", columns, tuple(rows), "predicted in parentheses")


_GAP = "false alarms of flagged less other decisions, 95 % interval; separation in same-mode floors"


def _taken_away(sweep: RegimeSweep, swept: Swept, gate: Gate) -> Table:
    share, separation = sweep.criteria.R3.flagged_share, sweep.criteria.R3.separation
    columns = (
        Column("prior"),
        Column("token entropy", "nat"),
        *(
            Column(f"replacement {one:g}", _REMOVED if not i else "", text=True)
            for i, one in enumerate(sweep.axes.replacement)
        ),
    )
    groups: dict[tuple[float, float], list[Result]] = {}
    for one in swept.grid:
        if one.arm == "shared" and one.flagged_share == share and one.cell.separation == separation:
            groups.setdefault((one.cell.prior, one.cell.token_entropy), []).append(one)
    rows = []
    for (prior, entropy), found in groups.items():
        cells = [
            with_bounds(one.removed.value, one.removed.interval, "+.1%") + (" *" if passes(one, gate) else "")
            for one in found
            if one.removed
        ]
        rows.append((f"{prior:g}", f"{entropy:.3g}", *cells))
    title = "Gap that a shared token takes away from heads with a token each"
    return Table(title, columns, tuple(rows), f"f {share:g}, separation {separation:g}")


_REMOVED = "share of training tokens replaced; * the cell passes the monitor study's gate"


def _beside(found: Estimate, predicted: float) -> str:
    return f"{with_bounds(found.value, found.interval, '+.1%')} ({predicted:+.1%})"
