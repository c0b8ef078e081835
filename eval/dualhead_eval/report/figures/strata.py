"""The residual by stratum: medians of same-mode and cross-mode pairs, and their shares (fig:strata)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from dualhead_eval.report.content import Report

#: Ratio of medians from which the axis is logarithmic.
_WIDE = 40
_COLORS = {"same": "tab:green", "cross": "tab:red"}


def strata_figure(report: Report, component: str = "position") -> Figure:
    """Per-condition medians of both strata, and each run's cross-mode share with its AUROC.

    Raises:
        ValueError: If no gate holds the component.
    """
    drawn = [run for run in report.runs if component in run.residuals]
    if not drawn:
        raise ValueError(f"no gate holds residual strata {component!r}, expected at least one: evaluate again")
    parts = [run.gate.strata[component].at(run.gate.index(run.first.tau, run.first.nfe)) for run in drawn]
    height = 1.5 + 0.33 * len(drawn)
    width = 6.4 + max(len(run.name) for run in drawn) * 0.06
    figure = Figure(figsize=(width, height), dpi=160, layout=ConstrainedLayoutEngine(wspace=0.05))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    rows = np.arange(len(drawn))[::-1]
    for row, run, strata in zip(rows, drawn, parts, strict=True):
        for column, (name, offset) in enumerate((("same", 0.16), ("cross", -0.16))):
            medians = strata.median[:, column]
            medians = medians[np.isfinite(medians)]
            left.plot(
                medians,
                np.full(medians.size, row + offset),
                "|",
                color=_COLORS[name],
                alpha=0.5,
                markersize=7,
                label=f"{name}-mode pairs" if row == rows[0] else None,
            )
        summary = run.residuals[component]
        share = summary.cross_share
        right.barh(row, 0 if np.isnan(share) else share, height=0.6, color="tab:red", alpha=0.6)
        text = "no residual" if np.isnan(share) else f"{share:.1%}"
        text += "" if np.isnan(summary.auroc) else f"   AUROC {summary.auroc:.3f}"
        right.text(0.02 if np.isnan(share) or share > 0.5 else share + 0.02, row, text, va="center", fontsize=7)
    left.set_yticks(rows, [run.name for run in drawn], fontsize=8)
    left.set_ylim(-0.6, len(drawn) - 0.4)
    left.set_xlabel(f"median residual per condition ({parts[0].unit})")
    medians = np.concatenate([strata.median[np.isfinite(strata.median)] for strata in parts])
    if medians.size and 0 < medians.max() <= _WIDE * medians.min():
        left.set_xlim(left=0)
    elif medians.size and medians.min() > 0:
        # A ring's residuals are ten times a robot's: a linear axis would show the one or the other.
        left.set_xscale("log")
    left.legend(fontsize=7, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    right.set_xlim(0, 1)
    right.set_xlabel("share of the residual from\ncross-mode pairs")
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
    return figure
