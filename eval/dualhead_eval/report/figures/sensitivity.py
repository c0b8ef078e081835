"""Sensitivity curves: effect and valid-pair rate against threshold or integration steps (app:sensitivity)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from dualhead_eval.statistics.sensitivity import SensitivityCurve

_AXIS = {"tau": r"threshold $\tau$", "nfe": "integration steps (NFE)"}


def sensitivity_figure(lines: Sequence[SensitivityCurve]) -> Figure:
    """Delta with its 95% band, and the valid-pair rate beside it; the reference is dashed.

    Raises:
        ValueError: If no curve is given or they scan different axes.
    """
    if not lines or len({line.axis for line in lines}) != 1:
        raise ValueError("curves of no or several axes given, expected one or more of one axis")
    figure = Figure(figsize=(9.2, 4.2), dpi=160, layout="constrained")
    effect, valid = figure.subplots(1, 2)
    for index, line in enumerate(lines):
        color = colormaps["tab10"](index % 10)
        style = ("-", "--", ":")[(index // 10) % 3]
        x = np.array(line.positions)
        delta = np.array([point.delta for point in line.points])
        low = np.array([point.intervals["delta"].low for point in line.points])
        high = np.array([point.intervals["delta"].high for point in line.points])
        effect.plot(x, delta, style, marker="o", markersize=3, color=color, label=line.label)
        effect.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)
        valid.plot(x, [point.valid_rate for point in line.points], style, marker="o", markersize=3, color=color)
    for ax in (effect, valid):
        for reference in sorted({line.reference for line in lines}):
            ax.axvline(reference, color="0.5", linestyle="--", linewidth=0.8)
        ax.set_xlabel(_AXIS[lines[0].axis])
        ax.spines[["top", "right"]].set_visible(False)
        if lines[0].axis == "nfe":
            ax.set_xscale("log")
            ticks = _apart(sorted({p for line in lines for p in line.positions}))
            ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
            ax.minorticks_off()
    effect.axhline(0, color="0.6", linewidth=0.8)
    effect.set_ylabel(r"effect $\Delta$ (95% band over conditions)")
    valid.set_ylabel("valid-pair rate")
    valid.set_ylim(0, 1.02)
    figure.legend(loc="outside lower center", ncols=3, fontsize=7, frameon=False)
    return figure


def _apart(positions: Sequence[float], ratio: float = 1.3) -> list[float]:
    """The positions whose labels do not collide on a logarithmic axis: each at least ``ratio`` times the one before."""
    kept: list[float] = []
    for position in positions:
        if not kept or position >= ratio * kept[-1]:
            kept.append(position)
    return kept
