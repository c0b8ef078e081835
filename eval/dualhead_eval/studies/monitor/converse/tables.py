"""The tables of the converse, as plain cells for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.report.table import Cell, Column, Table, number, with_bounds
from dualhead_eval.studies.monitor.converse.curve import ConverseVerdict, Point
from dualhead_eval.studies.monitor.converse.protocol import ConverseBudget, ConverseProtocol


def converse_tables(
    points: Sequence[Point], found: Sequence[ConverseVerdict], protocol: ConverseProtocol, budget: ConverseBudget
) -> list[Table]:
    """The curve and the verdicts."""
    return [_curve(points, protocol, budget), _verdicts(found)]


def _curve(points: Sequence[Point], protocol: ConverseProtocol, budget: ConverseBudget) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    for point in points:
        measures = point.measures
        graded = point.graded
        rows.append(
            (
                point.reading,
                str(point.amplitude_mm),
                number(measures["separation"].value, ".1f"),
                number(measures["floor"].value, ".1f"),
                with_bounds(point.ratio, measures["ratio"].interval(), ".2f"),
                with_bounds(measures["flagged"].value, measures["flagged"].interval(), ".1%"),
                number(measures["other"].value, ".1%"),
                with_bounds(measures["surcharge"].value, measures["surcharge"].interval(), "+.2%"),
                "-" if graded is None else with_bounds(graded.value, graded.interval(), "+.2%"),
                "-" if graded is None else with_bounds(graded.value, graded.interval(0.90), "+.2%"),
                point.finding(protocol.criteria.equivalence) or "-",
            )
        )
    return Table(
        title="False alarms by how far apart the two ways are",
        columns=(
            Column("reading", "whose pairs, and how their sides are told", text=True),
            Column("side step", "mm"),
            Column("separation", "of the two demonstrations at flagged decisions, mm"),
            Column("floor", "mean residual of flagged pairs on one side, mm"),
            Column("ratio", "separation / floor"),
            Column("flagged", "false alarms at flagged decisions"),
            Column("elsewhere", "at the others", detail=True),
            Column("raw surcharge", "flagged false alarms minus those of flagged pairs on one side"),
            Column("graded [95 %]", "A: less that of 0 mm; K apart: the same as raw"),
            Column("graded [90 %]", "", detail=True),
            Column("finding", "none: 90 % within the margin; surcharge: 95 % above 0", text=True),
        ),
        rows=tuple(rows),
        scope=f"training seeds {', '.join(map(str, budget.seeds))}, {budget.steps:,} steps, {budget.pairs} pairs, "
        f"margin {100 * protocol.criteria.equivalence:g} pp",
        notes=("95 % intervals over training seeds and pairs of demonstrations.",),
    )


def _verdicts(found: Sequence[ConverseVerdict]) -> Table:
    asked = {"C1": "no surcharge below a ratio of 1", "C2": "a surcharge above it"}
    return Table(
        title="The registered criteria of the converse",
        columns=(
            Column("criterion", text=True),
            Column("reading", text=True),
            Column("side steps", "mm, of which it is asked", text=True),
            Column("grade", text=True),
        ),
        rows=tuple(
            (f"{one.name}: {asked[one.name]}", one.reading, ", ".join(map(str, one.amplitudes_mm)) or "-", one.grade)
            for one in found
        ),
    )
