"""Unequal priors: capacity against the target's own, effect and distortion over the larger prior (fig:skew)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.paper.mechanism import Mechanism
from dualhead_eval.report.figures.lines import (
    SweepLine,
    colours,
    draw_lines,
    family_of,
    finish,
    finish_rho,
    sweep_lines,
)
from dualhead_eval.statistics.run import Run


def skew_lines(runs: Iterable[Run]) -> list[SweepLine]:
    """Runs on the ring of two modes, nullspace map, that differ in the larger prior alone."""
    return sweep_lines(runs, _line, lambda mechanism: mechanism.largest_prior, least=2)


def skew_figure(lines: list[SweepLine]) -> Figure:
    """C / max C beside the target's own, rho, and the distance of generated from target frequencies, over the prior.

    Raises:
        ValueError: If there is no line.
    """
    if not lines:
        raise ValueError("no mechanism was run at two priors, expected one to draw")
    figure = Figure(figsize=(12.5, 4.8), dpi=130, layout="constrained")
    capacity, effect, distortion = figure.subplots(1, 3)
    palette = colours(lines)
    draw_lines(capacity, lines, "capacity_relative", palette, paper=False)
    draw_lines(effect, lines, "rho", palette, paper=False)
    draw_lines(distortion, lines, "tv_target_p", palette, paper=False)
    prior = np.linspace(0.5, max(setting for line in lines for setting in line.settings), 100)
    capacity.plot(prior, 4 * prior * (1 - prior), color="black", linestyle=":", label="the target's own capacity")
    capacity.set_ylabel("C / max C")
    capacity.set_ylim(0, 1.05)
    finish(capacity)
    finish_rho(effect)
    effect.set_ylabel(r"$\rho$, mean over seeds")
    distortion.set_ylabel("TV, the position head's modes to the data's")
    distortion.set_ylim(bottom=0)
    finish(distortion)
    for ax in (capacity, effect, distortion):
        ax.set_xlabel("probability of the likelier mode")
    handles = capacity.get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3, fontsize=7.5, frameon=False)
    return figure


def _line(mechanism: Mechanism, run: Run) -> tuple[str, str] | None:
    if (mechanism.environment, mechanism.n_modes, mechanism.representation) != ("testbed", 2, "nullspace"):
        return None
    settings = (run.gate.provenance.get("dataset") or {}).get("env_kwargs") or {}
    if any(settings.get(name) is not None for name in ("mode_angles", "path_spread")):
        return None
    return family_of(mechanism), ""
