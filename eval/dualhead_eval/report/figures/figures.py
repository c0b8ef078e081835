"""All figures of a report, by name, as PNG bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.gate.gate import Gate
from dualhead_eval.paper.numbers import residual_mm
from dualhead_eval.report.content import Row
from dualhead_eval.report.figures.forest import forest_figure
from dualhead_eval.report.figures.heatmap import heatmap_figure
from dualhead_eval.report.figures.region import region_figure
from dualhead_eval.report.figures.sensitivity import sensitivity_figure
from dualhead_eval.report.figures.strata import strata_figure
from dualhead_eval.statistics.sensitivity import curves

#: What each figure shows, in the order of a report.
CAPTIONS = {
    "region": "Where each run lies: its effect against the most that its heads' variety allows.",
    "forest": "Which runs differ from independent heads, and which are equivalent to them within 2%.",
    "heatmap": "All quantities side by side; every column has its own scale.",
    "strata": "How far apart the two decodings are when the heads chose one mode, and when they did not.",
    "tau": "The same samples labelled at other thresholds: a stricter one costs valid pairs.",
    "nfe": "Samples drawn with other numbers of integration steps.",
}


def report_figures(gates: Sequence[Gate], rows: Sequence[Row], *, normalised: bool | None = None) -> dict[str, bytes]:
    """The figures that these gates allow, by name, in the order of :data:`CAPTIONS`."""
    summaries = [row.summary for row in rows]
    figures: dict[str, Figure] = {}
    if any(np.isfinite(summary.capacity) for summary in summaries):
        figures["region"] = region_figure(summaries, normalised=normalised)
    if any(np.isfinite(summary.rho) for summary in summaries):
        figures["forest"] = forest_figure(summaries)
    if len({row.summary.heads for row in rows}) == 1:
        figures["heatmap"] = heatmap_figure(summaries, [residual_mm(gate) for gate in gates])
    else:
        figures["heatmap"] = heatmap_figure(summaries)
    if any("position" in gate.strata for gate in gates):
        figures["strata"] = strata_figure(gates)
    for axis in ("tau", "nfe"):
        lines = curves(gates, axis)
        if lines:
            figures[axis] = sensitivity_figure(lines)
    return {name: _png(figure) for name, figure in figures.items()}


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
