"""The attainable region as a drawing that answers to pointer and keyboard: every point says which run it is.

Without a script every point still has its title; with one, a pointer shows all runs near it, arrow keys go from point
to point, and the name of a group picks its runs out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualhead_eval.report.answer import group_doings
from dualhead_eval.report.content import Report
from dualhead_eval.report.run_groups import RunGroup, group_runs
from dualhead_eval.report.table import RHO, number, with_bounds
from dualhead_eval.report.web.frame import text
from dualhead_eval.statistics.bootstrap import MARGIN
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.run_summary import RunSummary

_WIDTH, _HEIGHT = 720, 470
_LEFT, _RIGHT, _TOP, _BOTTOM = 84, 14, 14, 74


@dataclass(frozen=True)
class _Axes:
    limit: float
    low: float

    def x(self, value: float) -> float:
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * value / (1.05 * self.limit)

    def y(self, value: float) -> float:
        high = 1.1 * self.limit
        return _TOP + (_HEIGHT - _TOP - _BOTTOM) * (high - value) / (high - self.low)

    def points(self, *points: tuple[float, float]) -> str:
        return " ".join(f"{self.x(x):.1f},{self.y(y):.1f}" for x, y in points)


def region_svg(report: Report, *, normalised: bool | None = None) -> str:
    """The region with one point per pair of heads, and the names of its groups; empty without a point to draw.

    Args:
        report: The runs.
        normalised: Divide both axes by 1 - 1/K. By default only when the runs differ in K.
    """
    groups = group_runs(report.runs)
    drawn = [
        (index, run, pair)
        for index, group in enumerate(groups)
        for run in group.runs
        for pair in run.pairs
        if np.isfinite(pair.capacity)
    ]
    if not drawn:
        return ""
    if normalised is None:
        normalised = len({pair.n_modes for _, _, pair in drawn}) > 1
    scale = {id(pair): 1 - 1 / pair.n_modes if normalised else 1.0 for _, _, pair in drawn}
    limit = 1.0 if normalised else max(1 - 1 / pair.n_modes for _, _, pair in drawn)
    lowest = min(pair.delta / scale[id(pair)] for _, _, pair in drawn)
    axes = _Axes(limit, min(-0.12 * limit, 1.2 * lowest))
    marks = [
        _point(axes, index, run, pair, scale[id(pair)], first=position == 0)
        for position, (index, run, pair) in enumerate(drawn)
    ]
    lines = [
        _training(axes, index, runs, scale)
        for index, group in enumerate(groups)
        for runs in group.trainings
        if all(id(run.first) in scale for run in runs)
    ]
    over = " / (1 - 1/K)" if normalised else ""
    summary = (
        f"Effect against capacity of {len(drawn)} pairs of heads. Points lie between the floor, where heads choose "
        "independently, and the diagonal, where they always agree. The table below holds the same numbers."
    )
    return (
        f'<figure class="region"><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="group" aria-label="{text(summary)}">\n'
        + _frame(axes, over)
        + "\n".join([*lines, *marks])
        + '\n</svg>\n<div class="tip" hidden></div>\n'
        + "<figcaption>Every point is one pair of heads, with 95% intervals over conditions; hollow ones have too few "
        "valid pairs to be read, and a line joins the checkpoints of one training. Point at a run or a name."
        "</figcaption>\n" + _names(groups, {index for index, _, _ in drawn}) + "</figure>"
    )


def _frame(axes: _Axes, over: str) -> str:
    limit, low = axes.limit, axes.low
    beyond = axes.points((0, 0), (limit, limit), (limit, 1.1 * limit), (0, 1.1 * limit))
    parts = [
        f'<polygon class="out" points="{beyond}"/>',
        f'<polygon class="band" points="{axes.points((0, 0), (limit, MARGIN * limit), (limit, -MARGIN * limit))}"/>',
        f'<polyline class="edge" points="{axes.points((0, 0), (limit, limit))}"/>',
        f'<polyline class="grid" points="{axes.points((0, 0), (limit, 0))}"/>',
        f'<polyline class="grid dash" points="{axes.points((limit, low), (limit, 1.1 * limit))}"/>',
        f'<polyline class="axis" points="{axes.points((0, 1.1 * limit), (0, low), (1.05 * limit, low))}"/>',
    ]
    for value in np.linspace(0, limit, 6):
        x, y = axes.x(value), axes.y(low) + 20
        parts.append(f'<text class="tick" x="{x:.1f}" y="{y:.1f}" text-anchor="middle">{value:.1f}</text>')
    step = 0.2 * limit
    for value in np.arange(np.ceil(low / step), 6) * step:
        x, y = _LEFT - 8, axes.y(value) + 4
        parts.append(f'<text class="tick" x="{x}" y="{y:.1f}" text-anchor="end">{value + 0.0:.1f}</text>')
    middle = axes.y((1.1 * limit + low) / 2)
    parts += [
        f'<text class="name" x="{axes.x(limit / 2):.1f}" y="{_HEIGHT - 12}" text-anchor="middle">'
        f'capacity C{over}<tspan class="long">: how varied the heads are</tspan></text>',
        f'<text class="name" transform="translate(24 {middle:.1f}) rotate(-90)" text-anchor="middle">'
        f'effect Δ{over}<tspan class="long">: agreement above chance</tspan></text>',
        f'<text class="place" x="{axes.x(0.3 * limit):.1f}" y="{axes.y(0.72 * limit):.1f}" text-anchor="middle">'
        "no run can lie here (Δ &gt; C)</text>",
        f'<text class="place" x="{axes.x(0.985 * limit):.1f}" y="{axes.y(1.035 * limit):.1f}" text-anchor="end">'
        "corner: always together, every mode alive</text>",
        f'<text class="place" x="{axes.x(0.985 * limit):.1f}" y="{axes.y(-0.075 * limit):.1f}" text-anchor="end">'
        f"floor: independent heads ({RHO} = 0 within 2%)</text>",
        f'<text class="place" x="{axes.x(0.015 * limit):.1f}" y="{axes.y(-0.075 * limit):.1f}">origin: one mode</text>',
    ]
    return "\n".join(parts) + "\n"


def _point(axes: _Axes, group: int, run: Run, pair: RunSummary, scale: float, *, first: bool) -> str:
    x, y = pair.capacity / scale, pair.delta / scale
    shapes = []
    for name, across in (("capacity", True), ("delta", False)):
        interval = pair.intervals[name]
        if np.isfinite(interval.low):
            ends = [value / scale for value in (interval.low, interval.high)]
            points = [(end, y) for end in ends] if across else [(x, end) for end in ends]
            shapes.append(f'<polyline points="{axes.points(*points)}"/>')
    shapes.append(f'<circle cx="{axes.x(x):.1f}" cy="{axes.y(y):.1f}" r="6"/>')
    lines = "\n".join(_lines(run, pair))
    kind = "run" if pair.readable else "run unread"
    return (
        f'<g class="{kind}" data-group="{group}" tabindex="{0 if first else -1}" role="img" '
        f'aria-label="{text("; ".join(_lines(run, pair)))}"><title>{text_lines(lines)}</title>{"".join(shapes)}</g>'
    )


def text_lines(lines: str) -> str:
    """Several lines as text, their line ends kept."""
    return "\n".join(text(line) for line in lines.split("\n"))


def _lines(run: Run, pair: RunSummary) -> list[str]:
    """What a point says: name, effect, validity, training, reading."""
    training = []
    if run.training.seed is not None:
        training.append(f"seed {run.training.seed}")
    if run.training.steps is not None:
        training.append(f"{run.training.steps:,} steps")
    if run.training.loss != "unknown":
        training.append(f"loss {run.training.loss}")
    lines = [
        pair.name,
        f"{RHO} = {with_bounds(pair.rho, pair.intervals['rho'], '+.1%')}",
        f"valid pairs {number(pair.valid_rate, '.3f')}, C {number(pair.capacity, '.3f')}, "
        f"Δ {number(pair.delta, '+.3f')}",
        ", ".join(training),
        pair.reading,
    ]
    return [line for line in lines if line]


def _training(axes: _Axes, group: int, runs: tuple[Run, ...], scale: dict[int, float]) -> str:
    pairs = [run.first for run in runs]
    points = [(pair.capacity / scale[id(pair)], pair.delta / scale[id(pair)]) for pair in pairs]
    return f'<polyline class="training" data-group="{group}" points="{axes.points(*points)}"/>'


def _names(groups: list[RunGroup], drawn: set[int]) -> str:
    """The names of the groups, under what their heads do."""
    if len(drawn) < 2:
        return ""
    parts = []
    for doing, indices in group_doings(groups).items():
        items = [
            f'<li><button type="button" data-group="{index}">{text(groups[index].label)}'
            f"{f' <small>{len(groups[index].runs)}</small>' if len(groups[index].runs) > 1 else ''}</button></li>"
            for index in indices
            if index in drawn
        ]
        if items:
            parts.append(f"<p>{text(doing)}</p><ul>{''.join(items)}</ul>")
    return f'<div class="names">{"".join(parts)}</div>\n'
