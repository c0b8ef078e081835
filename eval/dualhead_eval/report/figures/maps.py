"""What a mechanism does under each representation map of the ring (the paper's fig:maps and tab:maps)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.paper.mechanism import Mechanism
from dualhead_eval.report.figures.lines import SweepLine, colours, family_of, finish_rho, sweep_lines
from dualhead_eval.statistics.run import Run

#: Maps in the order in which they are drawn.
MAPS = ("nullspace", "orthogonal", "polar")


def map_lines(runs: Iterable[Run]) -> list[SweepLine]:
    """Runs on the balanced ring of two modes that differ in the map alone; settings are positions in :data:`MAPS`."""
    return sweep_lines(runs, _line, _position, least=2)


def map_figure(lines: list[SweepLine]) -> Figure:
    """rho by map: seeds, their mean, the exact reference and the paper's number, side by side for every mechanism.

    Raises:
        ValueError: If there is no line.
    """
    if not lines:
        raise ValueError("no mechanism was run under two maps, expected one to draw")
    palette = colours(lines)
    names = list(palette)
    figure = Figure(figsize=(9.0, 5.2), dpi=130, layout="constrained")
    ax = figure.subplots()
    spread = 0.8 / len(names)
    for line in lines:
        colour = palette[line.what]
        offset = (names.index(line.what) - 0.5 * (len(names) - 1)) * spread
        for setting in line.settings:
            values, at = line.values(setting, "rho"), setting + offset
            if values.size and line.reference:
                ax.plot(at, values.mean(), "x", color="black", markersize=7, zorder=4)
            elif values.size:
                ax.bar(at, values.mean(), width=0.85 * spread, color=colour, alpha=0.35, zorder=2)
                ax.plot(np.full(values.size, at), values, "o", color=colour, markersize=3, zorder=3)
            if setting in line.paper:
                ax.plot(at, line.paper[setting], "D", color=colour, markersize=6, fillstyle="none", zorder=4)
    for name in names:
        ax.bar([0], [0], color=palette[name], alpha=0.35, label=name)
    if any(line.reference for line in lines):
        ax.plot([], [], "x", color="black", label="exact optimum")
    ax.set_xticks(range(len(MAPS)), MAPS)
    finish_rho(ax)
    ax.grid(axis="x", visible=False)
    figure.legend(loc="outside lower center", ncols=3, fontsize=7.5, frameon=False)
    return figure


def _position(mechanism: Mechanism) -> float:
    return float(MAPS.index(mechanism.representation)) if mechanism.representation in MAPS else float("nan")


def _line(mechanism: Mechanism, run: Run) -> tuple[str, str] | None:
    if mechanism.environment != "testbed" or mechanism.n_modes != 2 or not mechanism.standard:
        return None
    return family_of(mechanism), ""
