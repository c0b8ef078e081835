"""Every environment's runs in one attainable region, both axes over 1 - 1/K (the paper's fig:overlay)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dualhead_eval.report.content import ENVIRONMENTS, Report
from dualhead_eval.statistics.run import Run

_MARKERS = {2: "o", 3: "^", 4: "s", 8: "D"}
#: Where the magnified part, the high-capacity end, begins.
CLOSE = 0.9


def environments(report: Report) -> list[str]:
    """The partitions of the report's runs that have a capacity, in the order of appearance."""
    return list(dict.fromkeys(run.first.partition for run in _drawn(report)))


def overlay_figure(report: Report) -> Figure:
    """Two panels: the whole region, and its high-capacity end; a colour an environment, a marker a number of modes.

    Raises:
        ValueError: If no run has a capacity.
    """
    runs = _drawn(report)
    if not runs:
        raise ValueError("no run has a both-valid pair, expected at least one to draw: check the valid-pair rates")
    figure = Figure(figsize=(11.0, 5.4), dpi=130, layout="constrained")
    whole, close = figure.subplots(1, 2, sharey=True)
    for ax in (whole, close):
        _draw(ax, runs, environments(report))
    whole.set_xlim(0, 1.03)
    close.set_xlim(CLOSE, 1.005)
    lowest = min(_normalised(run.first.delta, run) for run in runs)
    whole.set_ylim(min(-0.1, 1.15 * lowest), 1.06)
    whole.set_ylabel(r"$\Delta$ / (1 - 1/K)")
    whole.set_title("all runs", fontsize=9)
    close.set_title("the high-capacity end", fontsize=9)
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _draw(ax: Axes, runs: list[Run], names: list[str]) -> None:
    ax.plot([0, 1], [0, 1], color="black", linewidth=1)
    ax.plot([0, 1], [0, -1], color="black", linewidth=0.8, linestyle=":")
    ax.axhline(0, color="0.5", linewidth=0.8)
    kinds = dict.fromkeys((run.first.partition, run.gate.n_modes) for run in runs)
    for name, modes in kinds:
        own = [run for run in runs if (run.first.partition, run.gate.n_modes) == (name, modes)]
        ax.scatter(
            [_normalised(run.first.capacity, run) for run in own],
            [_normalised(run.first.delta, run) for run in own],
            marker=_MARKERS.get(modes, "P"),
            color=f"C{names.index(name)}",
            s=28,
            alpha=0.65,
            edgecolors="black",
            linewidths=0.3,
            label=f"{ENVIRONMENTS.get(name, name or 'elsewhere')}, K = {modes}",
        )
    ax.set_xlabel("C / (1 - 1/K)")
    ax.spines[["top", "right"]].set_visible(False)


def _drawn(report: Report) -> list[Run]:
    return [run for run in report.runs if np.isfinite(run.first.capacity)]


def _normalised(value: float, run: Run) -> float:
    return value / (1 - 1 / run.gate.n_modes)
