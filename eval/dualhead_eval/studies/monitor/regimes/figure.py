"""The regime map: false alarms and thresholds against mismatch, and what a shared token takes away."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dualhead_eval.studies.monitor.regimes.definition import Cell, RegimeSweep
from dualhead_eval.studies.monitor.regimes.grading import passes
from dualhead_eval.studies.monitor.regimes.prediction import demonstrated_residuals
from dualhead_eval.studies.monitor.regimes.sweep import Swept
from dualhead_eval.studies.monitor.registration import Gate

#: From modes within a floor of each other to modes far apart.
_COLOURS = ("0.6", "tab:green", "tab:orange", "tab:red", "tab:purple", "tab:brown")


def regime_figure(sweep: RegimeSweep, swept: Swept, gate: Gate) -> Figure:
    """Above: gap against mismatch share, a panel per flagged share, and the threshold. Below: a map per prior."""
    figure = Figure(figsize=(10.5, 6.4), dpi=160, layout="constrained")
    above, below = np.asarray(figure.subfigures(2, 1, height_ratios=[1.25, 1]))
    panels = np.atleast_1d(above.subplots(1, len(sweep.flagged_shares) + 1))
    for axis, share in zip(panels, sweep.flagged_shares, strict=False):
        _gap_panel(axis, sweep, swept, share)
    _threshold_panel(panels[-1], sweep, swept, max(sweep.flagged_shares))
    panels[0].legend(
        fontsize=6, frameon=False, title="separation, floors", title_fontsize=6, loc="upper left"
    )  # fmt: skip
    maps = np.atleast_1d(below.subplots(1, len(sweep.axes.prior), sharey=True))
    for axis, prior in zip(maps, sweep.axes.prior, strict=True):
        _map(axis, sweep, swept, gate, prior)
    maps[0].set_ylabel("token entropy, nat", fontsize=7)
    below.suptitle(
        "false alarms that a shared token takes away, points "
        f"(f {sweep.criteria.R3.flagged_share:g}, separation {sweep.criteria.R3.separation:g}; "
        "framed: passes the study's gate)",
        fontsize=8,
    )
    return figure


def _gap_panel(axis: Axes, sweep: RegimeSweep, swept: Swept, share: float) -> None:
    mismatch = np.linspace(0, 0.5, 101)
    for separation, colour in zip(sweep.axes.separation, _COLOURS, strict=False):
        law = demonstrated_residuals(_angle(sweep, separation))
        gaps = [100 * law.predict(share, float(x), sweep.alpha).gap for x in mismatch]
        axis.plot(mismatch, gaps, color=colour, linewidth=1.2, label=f"{separation:g}")
        found = [r for r in swept.grid if r.flagged_share == share and r.cell.separation == separation]
        axis.plot([r.mismatch for r in found], [100 * r.found.gap.value for r in found], ".", color=colour,
                  markersize=3, alpha=0.5)  # fmt: skip
    _mark_turn(axis, sweep.alpha / share)
    axis.set_title(f"gap, f {share:g}", fontsize=8)
    axis.set_ylabel("flagged less other, points", fontsize=7)
    _tidy(axis)


def _threshold_panel(axis: Axes, sweep: RegimeSweep, swept: Swept, share: float) -> None:
    mismatch = np.linspace(0, 0.5, 101)
    for separation, colour in zip(sweep.axes.separation, _COLOURS, strict=False):
        law = demonstrated_residuals(_angle(sweep, separation))
        floor = law.predict(share, 0.0, sweep.alpha).threshold
        ratios = [law.predict(share, float(x), sweep.alpha).threshold / floor for x in mismatch]
        axis.plot(mismatch, ratios, color=colour, linewidth=1.2)
        found = [r for r in swept.grid if r.flagged_share == share and r.cell.separation == separation]
        axis.plot([r.mismatch for r in found], [r.found.threshold / r.found.floor for r in found], ".", color=colour,
                  markersize=3, alpha=0.5)  # fmt: skip
    _mark_turn(axis, sweep.alpha / share)
    axis.set_title(f"threshold, f {share:g}", fontsize=8)
    axis.set_ylabel("over that of other decisions", fontsize=7)
    _tidy(axis)


def _mark_turn(axis: Axes, turn: float) -> None:
    """f x = alpha."""
    if turn < 0.5:
        axis.axvline(turn, color="0.7", linewidth=0.8, linestyle="--", zorder=0)
        axis.annotate(r"f x = $\alpha$", (turn, 1), xycoords=("data", "axes fraction"), xytext=(3, -8),
                      textcoords="offset points", fontsize=6, color="0.4")  # fmt: skip


def _map(axis: Axes, sweep: RegimeSweep, swept: Swept, gate: Gate, prior: float) -> None:
    rule, entropies, replacements = sweep.criteria.R3, sweep.axes.token_entropy, sweep.axes.replacement
    shown = np.full((len(entropies), len(replacements)), np.nan)
    for one in swept.grid:
        here = one.arm == "shared" and one.flagged_share == rule.flagged_share and one.removed is not None
        if not here or one.cell.prior != prior or one.cell.separation != rule.separation:
            continue
        row, column = entropies.index(one.cell.token_entropy), replacements.index(one.cell.replacement)
        assert one.removed is not None
        shown[row, column] = 100 * one.removed.value
        if passes(one, gate):
            axis.add_patch(Rectangle((column - 0.47, row - 0.47), 0.94, 0.94, fill=False, linewidth=1.4))
    axis.imshow(shown, cmap="YlGn", vmin=0, vmax=70, origin="lower", aspect="auto")
    for (row, column), value in np.ndenumerate(shown):
        axis.text(column, row, f"{value:+.1f}", ha="center", va="center", fontsize=7)
    axis.set_xticks(range(len(replacements)), [f"{one:g}" for one in replacements], fontsize=7)
    axis.set_yticks(range(len(entropies)), [f"{one:.3g}" for one in entropies], fontsize=7)
    axis.set_xlabel("tokens replaced in training", fontsize=7)
    axis.set_title(f"prior {prior:g}", fontsize=8)


def _angle(sweep: RegimeSweep, separation: float) -> float:
    axes = sweep.axes
    return Cell(
        prior=axes.prior[0],
        token_entropy=axes.token_entropy[0],
        replacement=axes.replacement[0],
        separation=separation,
    ).mode_angle


def _tidy(axis: Axes) -> None:
    axis.set_xlabel("x, share of pairs in two modes", fontsize=7)
    axis.tick_params(labelsize=7)
    axis.spines[["top", "right"]].set_visible(False)
