"""All figures of a report, by name, as PNG bytes."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.report.content import Report
from dualhead_eval.report.figures.forest import forest_figure
from dualhead_eval.report.figures.heatmap import heatmap_figure
from dualhead_eval.report.figures.ladder import ladder_figure, ladder_lines
from dualhead_eval.report.figures.lines import SweepLine
from dualhead_eval.report.figures.maps import map_figure, map_lines
from dualhead_eval.report.figures.mode_counts import mode_count_figure, mode_count_lines
from dualhead_eval.report.figures.overlay import environments, overlay_figure
from dualhead_eval.report.figures.region import region_figure
from dualhead_eval.report.figures.sensitivity import sensitivity_figure
from dualhead_eval.report.figures.skew import skew_figure, skew_lines
from dualhead_eval.report.figures.strata import strata_figure
from dualhead_eval.statistics.run import Run

#: What each figure shows, in the order of a report.
CAPTIONS = {
    "region": "Where each run lies: its effect against the most that its heads' variety allows.",
    "forest": "Which runs differ from independent heads, and which are equivalent to them within 2%.",
    "heatmap": "All quantities side by side; every column has its own scale.",
    "strata": "How far apart the two decodings are when the heads chose one mode, and when they did not.",
    "tau": "The same samples labelled at other thresholds: a stricter one costs valid pairs.",
    "nfe": "Samples drawn with other numbers of integration steps.",
    "ladder": "Endpoint consistency: what more weight does to the effect, to validity, and to where a run lies.",
    "modes": "The same mechanisms with more modes to choose from.",
    "maps": "The same mechanisms under the ring's three representation maps.",
    "skew": "Unequal mode frequencies: capacity against the target's own, effect, and how far the frequencies move.",
    "overlay": "All environments in one region, both axes over what K modes allow.",
}

#: Figures of lines: their name, the lines that runs make, and how these are drawn.
SWEEPS: tuple[tuple[str, Callable[[Iterable[Run]], list[SweepLine]], Callable[[list[SweepLine]], Figure]], ...] = (
    ("ladder", ladder_lines, ladder_figure),
    ("modes", mode_count_lines, mode_count_figure),
    ("maps", map_lines, map_figure),
    ("skew", skew_lines, skew_figure),
)


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
    for name, lines_of, draw in SWEEPS:
        if found := lines_of(report.runs):
            figures[name] = draw(found)
    if len(environments(report)) > 1:
        figures["overlay"] = overlay_figure(report)
    return {name: _png(figure) for name, figure in figures.items()}


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
