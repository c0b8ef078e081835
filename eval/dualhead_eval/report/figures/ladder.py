"""The ladder of endpoint consistency: effect, validity and path in the region over lambda (the paper's fig:ladder)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.paper.mechanism import Mechanism
from dualhead_eval.report.figures.lines import (
    SweepLine,
    colours,
    draw_lines,
    finish,
    finish_rho,
    style_of,
    sweep_lines,
    training_of,
)
from dualhead_eval.statistics.run import Run

#: Weights of a line that is worth drawing, 0 among them or not.
STEPS = 3


def ladder_lines(runs: Iterable[Run]) -> list[SweepLine]:
    """Lines of runs that differ in lambda alone: one an environment, map, beta and network."""
    return sweep_lines(runs, _line, lambda mechanism: mechanism.consistency, least=STEPS)


def ladder_figure(lines: list[SweepLine]) -> Figure:
    """rho and valid-pair rate over lambda, and the paths through the (C, Delta) plane.

    Raises:
        ValueError: If there is no line.
    """
    if not lines:
        raise ValueError(f"no mechanism was run at {STEPS} or more weights of consistency, expected one to draw")
    figure = Figure(figsize=(12.5, 4.8), dpi=130, layout="constrained")
    effect, valid, plane = figure.subplots(1, 3, width_ratios=(1.3, 1, 1))
    palette = colours(lines)
    draw_lines(effect, lines, "rho", palette, paper=True)
    draw_lines(valid, lines, "valid_rate", palette, paper=False)
    ticks = sorted({setting for line in lines for setting in line.settings})
    smallest = min(tick for tick in ticks if tick > 0)
    for ax in (effect, valid):
        # Linear up to the smallest weight: lambda 0 belongs on the axis.
        ax.set_xscale("symlog", linthresh=smallest, linscale=0.6)
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.minorticks_off()
        ax.set_xlabel(r"consistency weight $\lambda$")
    finish_rho(effect)
    valid.set_ylabel("valid-pair rate")
    valid.set_ylim(0, 1.03)
    finish(valid)
    largest = max(1 - 1 / run.gate.n_modes for line in lines for runs in line.runs.values() for run in runs)
    plane.plot([0, largest], [0, largest], color="black", linewidth=1)
    plane.axhline(0, color="0.5", linewidth=0.8)
    for line in lines:
        colour, style = palette[line.what], style_of(line, lines)
        capacity, delta = line.means("capacity"), line.means("delta")
        plane.plot(capacity, delta, style, color=colour, linewidth=1)
        plane.scatter(capacity, delta, s=12 + 14 * np.arange(len(delta)), color=colour, alpha=0.6, linewidths=0)
    plane.set_xlim(0, 1.04 * largest)
    plane.set_xlabel("capacity C")
    plane.set_ylabel(r"effect $\Delta$ (larger dots: larger $\lambda$)")
    finish(plane)
    figure.legend(*effect.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5, frameon=False)
    return figure


def _line(mechanism: Mechanism, run: Run) -> tuple[str, str] | None:
    if not mechanism.environment or mechanism.token or mechanism.latent or not mechanism.standard:
        return None
    where = mechanism.environment if mechanism.environment != "testbed" else f"ring {mechanism.representation}"
    modes = "" if mechanism.n_modes == 2 else f", K = {mechanism.n_modes}"
    return f"{where}{modes}, beta {mechanism.beta:g}", training_of(run)
