"""The figure of the converse: surcharge against separation over floor, and the false alarms behind it."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dualhead_eval.report.figures.monitor import png
from dualhead_eval.studies.monitor.converse.curve import GRADED, Point
from dualhead_eval.studies.monitor.converse.protocol import ConverseProtocol

CAPTION = (
    "Left: mismatch surcharge against the separation of the two ways over the residual of pairs on one side; labels "
    "are side steps in mm, bars 95 %, the band +-1 percentage point. Middle: the same near a ratio of 1. Right: false "
    "alarms at flagged decisions."
)
_COLOURS = {"A": "tab:red", "K apart": "tab:blue", "K together": "tab:green"}
_NAMES = {"A": "A, less 0 mm", "K apart": "K apart, sides by token"}


def converse_figure(points: Sequence[Point], protocol: ConverseProtocol) -> bytes:
    """The figure as a PNG."""
    figure = Figure(figsize=(10.5, 3.4), dpi=150, layout="constrained")
    whole, near, alarms = figure.subplots(1, 3)
    for axis in (whole, near):
        _surcharges(axis, points, protocol)
    whole.legend(fontsize=7, frameon=False, loc="upper left")
    near.set_xlim(-0.05, 2.0 * protocol.criteria.ratio)
    near.set_ylim(-2.5, 8.0)
    for reading, colour in _COLOURS.items():
        own = [point for point in points if point.reading == reading]
        _line(
            alarms, [float(point.amplitude_mm) for point in own], [point.measures["flagged"] for point in own], colour,
            reading,
        )  # fmt: skip
    alarms.axhline(100 * protocol.scoring.alpha, color="0.7", linewidth=0.8, zorder=0)
    alarms.set_xlabel("side step, mm", fontsize=8)
    alarms.set_ylabel("false alarms at flagged decisions, %", fontsize=8)
    alarms.legend(fontsize=7, frameon=False)
    for axis in (whole, near, alarms):
        axis.tick_params(labelsize=7)
        axis.spines[["top", "right"]].set_visible(False)
    return png(figure)


def _surcharges(axis: Axes, points: Sequence[Point], protocol: ConverseProtocol) -> None:
    margin = 100 * protocol.criteria.equivalence
    axis.axhspan(-margin, margin, color="0.92", zorder=0)
    axis.axvline(protocol.criteria.ratio, color="0.7", linewidth=0.8, zorder=0)
    for reading in GRADED:
        own = [point for point in points if point.reading == reading and point.graded is not None]
        shown = [point.graded for point in own if point.graded is not None]
        _line(axis, [point.ratio for point in own], shown, _COLOURS[reading], _NAMES[reading])
        for point, measure in zip(own, shown, strict=True):
            axis.annotate(
                str(point.amplitude_mm), (point.ratio, 100 * measure.value), xytext=(4, 4),
                textcoords="offset points", fontsize=6, color=_COLOURS[reading], annotation_clip=True,
            )  # fmt: skip
    axis.set_xlabel("separation / same-mode floor", fontsize=8)
    axis.set_ylabel("mismatch surcharge, percentage points", fontsize=8)


def _line(axis: Axes, x: Sequence[float], measures: Sequence, colour: str, label: str) -> None:
    y = [100 * measure.value for measure in measures]
    axis.plot(x, y, "o-", color=colour, linewidth=1.0, markersize=3.5, label=label)
    for place, measure in zip(x, measures, strict=True):
        interval = measure.interval()
        axis.plot([place, place], [100 * interval.low, 100 * interval.high], color=colour, linewidth=1.4)
