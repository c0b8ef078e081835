"""All figures of a report, by name, as PNG bytes."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.report.content import Report
from dualhead_eval.report.figures.forest import forest_figure
from dualhead_eval.report.figures.heatmap import heatmap_figure
from dualhead_eval.report.figures.region import region_figure
from dualhead_eval.report.figures.sensitivity import sensitivity_figure
from dualhead_eval.report.figures.strata import strata_figure

#: What each figure shows, in the order of a report.
CAPTIONS = {
    "region": "Where each run lies: its effect against the most that its heads' variety allows.",
    "forest": "Which runs differ from independent heads, and which are equivalent to them within 2%.",
    "heatmap": "All quantities side by side; every column has its own scale.",
    "strata": "How far apart the two decodings are when the heads chose one mode, and when they did not.",
    "tau": "The same samples labelled at other thresholds: a stricter one costs valid pairs.",
    "nfe": "Samples drawn with other numbers of integration steps.",
}


def report_figures(report: Report, *, normalised: bool | None = None) -> dict[str, bytes]:
    """The figures that the report's runs allow, by name, in the order of :data:`CAPTIONS`."""
    figures: dict[str, Figure] = {}
    if any(np.isfinite(pair.capacity) for pair in report.pairs):
        figures["region"] = region_figure(report, normalised=normalised)
    if any(np.isfinite(pair.rho) for pair in report.pairs):
        figures["forest"] = forest_figure(report)
    if report.runs:
        figures["heatmap"] = heatmap_figure(report)
    if any("position" in run.residuals for run in report.runs):
        figures["strata"] = strata_figure(report)
    for axis, lines in (("tau", report.tau_curves), ("nfe", report.nfe_curves)):
        if lines:
            figures[axis] = sensitivity_figure(lines)
    return {name: _png(figure) for name, figure in figures.items()}


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
