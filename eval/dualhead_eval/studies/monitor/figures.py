"""Figures of the monitor study: the gap and the AUROC of every arm and signal, beside the paper's rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dualhead_eval.paper.numbers import paper_numbers
from dualhead_eval.report.figures.monitor import CAPTIONS, delay_figure, png, roc_figure
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.studies.monitor.conclusions import Conclusions

#: What each figure shows.
STUDY_CAPTIONS = {
    "forest": (
        "Left: false alarms where two modes are open minus elsewhere, in percentage points; the grey rows are the "
        "paper's on LIBERO-plus. Right: AUROC within kind and level at the same decision. Bars: 95 %, over training "
        "seeds and episodes; dots: single seeds."
    ),
    "roc": CAPTIONS["roc"] + " First seed of each arm.",
    "delay": CAPTIONS["delay"] + " First seed of each arm.",
}
#: Signals drawn, and their colours.
_COLOURS = {"residual": "tab:red", "residual_mean": "tab:orange", "residual_matched": "tab:blue"}
#: The paper's rows of tab:fagap.
_PAPER = ("coordinated residual", "uncoordinated residual")


def study_figures(found: Conclusions) -> dict[str, bytes]:
    """The study's figures by name, as PNG bytes."""
    logs = list(found.alarms.values())
    figures = {
        "forest": forest_figure(found),
        "roc": roc_figure(logs, list(_COLOURS)),
        "delay": delay_figure(logs, ["residual"]),
    }
    return {name: png(figure) for name, figure in figures.items() if figure is not None}


def forest_figure(found: Conclusions) -> Figure:
    """A line per arm and signal: gap and AUROC."""
    rows = [(arm, signal) for arm, signal in found.families if signal in _COLOURS]
    paper = _paper_rows()
    figure = Figure(figsize=(8.5, 1.1 + 0.24 * (len(rows) + len(paper))), dpi=160, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    names = [f"{arm}: {signal}" for arm, signal in rows] + [f"paper: {name}" for name, _, _ in paper]
    places = np.arange(len(names))[::-1]
    for place, (arm, signal) in zip(places, rows, strict=False):
        measures, colour = found.families[arm, signal], _COLOURS[signal]
        for axis, name, scale in ((left, "gap", 100.0), (right, "auroc", 1.0)):
            measure = measures[name]
            _line(axis, float(place), measure.value, measure.interval(), measure.by_seed, colour, scale)
    for place, (_, value, interval) in zip(places[len(rows) :], paper, strict=True):
        _line(left, float(place), value, interval, (), "0.5", 100.0)
    left.axvline(0, color="0.8", linewidth=0.8, zorder=0)
    right.axvline(0.5, color="0.8", linewidth=0.8, zorder=0)
    left.set_yticks(places, names, fontsize=7)
    left.set_xlabel("gap of false alarms, percentage points", fontsize=8)
    right.set_xlabel("AUROC, within kind and level, matched in time", fontsize=8)
    for axis in (left, right):
        axis.tick_params(labelsize=7)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def _line(
    axis: Axes, place: float, value: float, interval: Interval, seeds: Sequence[float] | np.ndarray, colour: str,
    scale: float,
) -> None:  # fmt: skip
    if np.isfinite(interval.low):
        axis.plot([scale * interval.low, scale * interval.high], [place, place], color=colour, linewidth=1.4)
    axis.plot(scale * value, place, "o", color=colour, markersize=4)
    for one in seeds:
        axis.plot(scale * one, place - 0.28, ".", color=colour, markersize=2.5, alpha=0.7)


def _paper_rows() -> list[tuple[str, float, Interval]]:
    rows = {row.row: row for row in paper_numbers() if row.source == "tab:fagap" and row.quantity == "false_alarm_gap"}
    found = []
    for name in _PAPER:
        row = rows[f"libero/{name}"]
        assert row.value is not None
        assert row.low is not None
        assert row.high is not None
        found.append((name, row.value, Interval(row.low, row.high, 0.95)))
    return found
