"""The attainable region: effect against capacity, one point per run (the paper's fig:region).

No run can lie above the diagonal. On it the heads always agree; at its origin only because neither varies.
"""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.report.content import Report
from dualhead_eval.report.figures.label_placement import LINE, label_beside
from dualhead_eval.statistics.bootstrap import MARGIN

_LABEL_SIZE = 8
_MARKERS = {2: "o", 3: "^", 4: "s", 8: "D"}


def draw_region(report: Report, path: str | os.PathLike, *, normalised: bool | None = None) -> Path:
    """Draw the runs in the (C, Delta) plane and save a PNG, whole or not at all.

    Args:
        report: The runs.
        path: File to write; its folder is created.
        normalised: Divide both axes by 1 - 1/K. By default only when the runs differ in K.

    Raises:
        ValueError: If no run has a capacity to draw.
    """
    target, buffer = Path(path), io.BytesIO()
    region_figure(report, normalised=normalised).savefig(buffer, format="png")
    write_bytes(target, buffer.getvalue())
    return target


def region_figure(report: Report, *, normalised: bool | None = None) -> Figure:
    """The attainable region with one point per pair of heads.

    Raises:
        ValueError: If no run has a capacity to draw.
    """
    drawn = [s for s in report.pairs if np.isfinite(s.capacity)]
    if not drawn:
        raise ValueError("no run has a both-valid pair, expected at least one to draw: check the valid-pair rates")
    if normalised is None:
        normalised = len({s.n_modes for s in drawn}) > 1

    # Room for one line per label, and beside the axes for the longest.
    height = max(5.6, 1.5 + len(drawn) * LINE * _LABEL_SIZE / 72)
    width = 6.2 + max(len(s.name) for s in drawn) * 0.56 * _LABEL_SIZE / 72
    figure = Figure(figsize=(width, height), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    limit = 1.0 if normalised else max(1 - 1 / s.n_modes for s in drawn)
    scales = np.array([1 - 1 / s.n_modes if normalised else 1.0 for s in drawn])
    x = np.array([s.capacity for s in drawn]) / scales
    y = np.array([s.delta for s in drawn]) / scales
    _draw_frame(ax, limit, lowest=float(y.min()))
    for s, scale in zip(drawn, scales, strict=True):
        for name, across in (("capacity", True), ("delta", False)):
            interval = s.intervals[name]
            if np.isfinite(interval.low):
                ends = [interval.low / scale, interval.high / scale]
                here = [s.delta / scale] * 2 if across else [s.capacity / scale] * 2
                ax.plot(*(ends, here) if across else (here, ends), color="0.35", linewidth=1, zorder=2)
    scatter = None
    for n_modes in sorted({s.n_modes for s in drawn}):
        chosen = np.array([s.n_modes == n_modes for s in drawn])
        scatter = ax.scatter(
            x[chosen],
            y[chosen],
            c=[s.valid_rate for s in drawn if s.n_modes == n_modes],
            marker=_MARKERS.get(n_modes, "P"),
            cmap="viridis",
            vmin=0,
            vmax=1,
            s=46,
            edgecolors="black",
            linewidths=0.7,
            zorder=3,
            label=f"K = {n_modes}",
        )
    assert scatter is not None
    bar = figure.colorbar(scatter, ax=ax, label="valid-pair rate", orientation="horizontal", shrink=0.6, aspect=40)
    bar.ax.tick_params(labelsize=7)
    over = " / (1 - 1/K)" if normalised else ""
    ax.set_xlabel(f"capacity C{over}   (how varied the heads are)")
    ax.set_ylabel(f"effect Δ{over}   (agreement above chance)")
    ax.set_title("Attainable region of coordination, with 95% intervals over conditions", fontsize=10, loc="left")
    if len({s.n_modes for s in drawn}) > 1:
        ax.legend(loc="upper left", frameon=False, fontsize=8)
    figure.canvas.draw()
    label_beside(ax, x.tolist(), y.tolist(), [s.name for s in drawn], size=_LABEL_SIZE)
    return figure


def _draw_frame(ax: Axes, limit: float, lowest: float) -> None:
    """The diagonal, the floor, the equivalence band and the lower side."""
    line = np.array([0.0, limit])
    ax.fill_between(line, -MARGIN * line, MARGIN * line, color="tab:blue", alpha=0.18, linewidth=0, zorder=0)
    ax.plot(line, line, color="black", linewidth=1.2, zorder=1)
    ax.plot(line, 0 * line, color="0.5", linewidth=0.8, zorder=1)
    ax.axvspan(limit, 1.06 * limit, color="0.93", linewidth=0, zorder=0)
    ax.fill_between(line, line, 1.12 * limit, color="0.93", linewidth=0, zorder=0)
    ax.set_xlim(0, 1.06 * limit)
    low = min(-0.12 * limit, 1.25 * lowest)
    ax.set_ylim(low, 1.12 * limit)
    if lowest < -0.05 * limit:
        ax.plot(line, -line, color="black", linewidth=0.8, linestyle=":", zorder=1)
    ax.axvline(limit, color="0.5", linewidth=0.8, linestyle="--", zorder=1)
    ax.text(0.33 * limit, 0.62 * limit, "no run can be here (Δ > C)", color="0.45", fontsize=8, ha="center")
    ax.annotate(
        r"blue: $\rho = 0$ within 2%",
        # To the right of the dotted side, where there is one.
        (0.25 * limit if lowest < -0.05 * limit else 0, 0),
        xytext=(4, -9),
        textcoords="offset points",
        color="tab:blue",
        fontsize=7,
        ha="left",
        va="top",
    )
