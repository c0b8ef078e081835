"""Mechanisms over the number of modes: normalised effect and capacity (the paper's fig:ksweep, panel a)."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.figure import Figure

from dualhead_eval.effects.sites import CORNER_CAPACITY, CORNER_RHO
from dualhead_eval.paper.mechanism import Mechanism
from dualhead_eval.report.figures.lines import (
    SweepLine,
    colours,
    draw_lines,
    family_of,
    finish,
    finish_rho,
    sweep_lines,
    training_of,
)
from dualhead_eval.statistics.run import Run


def mode_count_lines(runs: Iterable[Run]) -> list[SweepLine]:
    """Lines of runs on the balanced ring that differ in the number of modes alone."""
    return sweep_lines(runs, _line, lambda mechanism: float(mechanism.n_modes), least=2)


def mode_count_figure(lines: list[SweepLine]) -> Figure:
    """rho and C / max C over K, with the corner's criterion.

    Raises:
        ValueError: If there is no line.
    """
    if not lines:
        raise ValueError("no mechanism was run at two numbers of modes, expected one to draw")
    figure = Figure(figsize=(10.5, 5.0), dpi=130, layout="constrained")
    effect, capacity = figure.subplots(1, 2, width_ratios=(1.3, 1))
    palette = colours(lines)
    draw_lines(effect, lines, "rho", palette, paper=True)
    draw_lines(capacity, lines, "capacity_relative", palette, paper=False)
    effect.axhline(CORNER_RHO, color="black", linestyle=":", linewidth=1)
    capacity.axhline(CORNER_CAPACITY, color="black", linestyle=":", linewidth=1)
    finish_rho(effect)
    capacity.set_ylabel("C / max C")
    capacity.set_ylim(0, 1.05)
    finish(capacity)
    ticks = sorted({setting for line in lines for setting in line.settings})
    for ax in (effect, capacity):
        ax.set_xscale("log", base=2)
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.minorticks_off()
        ax.set_xlabel("number of modes K (dotted: the corner's criterion)")
    figure.legend(*effect.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=7.5, frameon=False)
    return figure


def _line(mechanism: Mechanism, run: Run) -> tuple[str, str] | None:
    if mechanism.environment != "testbed" or not mechanism.representation or not mechanism.standard:
        return None
    return f"{mechanism.representation}, {family_of(mechanism)}", training_of(run)
