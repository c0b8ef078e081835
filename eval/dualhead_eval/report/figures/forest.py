"""Forest plot: every run's rho with its interval, against the equivalence band (the paper's fig:forest)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator, PercentFormatter

from dualhead_eval.report.content import Report
from dualhead_eval.statistics.bootstrap import MARGIN

#: Half-width of the close-up around zero.
_CLOSE_UP = 0.06
#: Effects up to this are drawn in it; of larger ones it names the value.
_SHOWN = 0.93 * _CLOSE_UP


def forest_figure(report: Report) -> Figure:
    """Two panels: the whole range, and a close-up of the floor; pairs of heads in the report's order.

    Intervals are over conditions.

    Raises:
        ValueError: If no run has a defined rho.
    """
    drawn = [run for run in report.pairs if np.isfinite(run.rho)]
    if not drawn:
        raise ValueError("no run has a defined rho, expected at least one for a forest plot")
    height = 1.3 + 0.27 * len(drawn)
    # Room beside the panels for the longest label.
    width = 6.4 + max(len(run.name) for run in drawn) * 0.06
    figure = Figure(figsize=(width, height), dpi=160, layout=ConstrainedLayoutEngine(wspace=0.05))
    whole, close = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    rows = np.arange(len(drawn))[::-1]
    for ax in (whole, close):
        ax.axvspan(-MARGIN, MARGIN, color="tab:blue", alpha=0.15, linewidth=0)
        ax.axvline(0, color="0.4", linewidth=0.8)
        ax.spines[["top", "right"]].set_visible(False)
        ax.set_xlabel(r"$\rho$, 95% interval")
        ax.xaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        ax.tick_params(axis="x", labelsize=8)
        for row, run in zip(rows, drawn, strict=True):
            if ax is close and abs(run.rho) > _SHOWN:
                continue
            interval = run.intervals["rho"]
            color = "tab:blue" if run.equivalence.equivalent else "black"
            if np.isfinite(interval.low):
                ax.plot([interval.low, interval.high], [row, row], color=color, linewidth=1.4)
            ax.plot(run.rho, row, "o", color=color, markersize=4)
    low = float(np.nanmin([-0.05, *(run.rho for run in drawn), *(run.intervals["rho"].low for run in drawn)]))
    whole.set_xlim(1.08 * low - 0.02, 1.05)
    whole.set_yticks(rows, [run.name for run in drawn], fontsize=8)
    whole.set_ylim(-0.7, len(drawn) - 0.3)
    whole.xaxis.set_major_locator(MaxNLocator(5))
    close.set_xlim(-_CLOSE_UP, _CLOSE_UP)
    close.set_xticks([-2 * MARGIN, -MARGIN, 0, MARGIN, 2 * MARGIN])
    close.set_title("close-up of zero", fontsize=9)
    whole.set_title(f"blue: equivalent to zero within {MARGIN:.0%} (band)", fontsize=9)
    for row, run in zip(rows, drawn, strict=True):
        if abs(run.rho) > _SHOWN:
            close.text(
                np.sign(run.rho) * _CLOSE_UP * 0.97,
                row,
                f"{run.rho:+.0%} →" if run.rho > 0 else f"← {run.rho:+.0%}",
                ha="right" if run.rho > 0 else "left",
                va="center",
                fontsize=7,
                color="0.45",
            )
    return figure
