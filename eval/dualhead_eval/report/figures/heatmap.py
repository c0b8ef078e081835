"""Heat map: capacity, effect, entropy, valid-pair rate and residual of every run (the paper's fig:atlas)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from dualhead_eval.report.content import Report


def heatmap_figure(report: Report) -> Figure:
    """One row per pair of heads, one column per quantity, each column on its own scale, numbers printed.

    The residual belongs to a run's first two heads; its column is left out only where no run holds one.

    Raises:
        ValueError: If the report holds no run.
    """
    runs = report.pairs
    if not runs:
        raise ValueError("no run was given, expected at least one for a heat map")
    columns: list[tuple[str, list[float], str, str]] = [
        ("C / max C", [run.capacity_relative for run in runs], ".3f", "YlGn"),
        (r"$\Delta$", [run.delta for run in runs], "+.4f", "RdBu"),
        (r"$\rho$", [run.rho for run in runs], "+.1%", "RdBu"),
        ("entropy A / ln K", [run.entropy_q / np.log(run.n_modes) for run in runs], ".3f", "YlGn"),
        ("entropy B / ln K", [run.entropy_p / np.log(run.n_modes) for run in runs], ".3f", "YlGn"),
        ("valid-pair rate", [run.valid_rate for run in runs], ".3f", "YlGn"),
    ]
    residuals = [
        np.nan if run.residual_mm is None or pair is not run.first else run.residual_mm
        for run, pair in report.run_pairs
    ]
    if np.isfinite(residuals).any():
        columns.append(("residual (mm)", residuals, ".1f", "Oranges"))
    figure = Figure(figsize=(2.2 + 1.05 * len(columns), 1.1 + 0.3 * len(runs)), dpi=160)
    axes = figure.subplots(1, len(columns), sharey=True)
    for ax, (name, values, spec, palette) in zip(axes, columns, strict=True):
        shown = np.array(values, dtype=float)[:, None]
        if palette == "RdBu":
            low, high = -max(0.5 if "Delta" in name else 1.0, np.nanmax(np.abs(shown), initial=0)), None
            high = -low
        elif spec == ".1f":
            low, high = 0.0, 1.4 * np.nanmax(shown, initial=1.0)
        else:
            # Full marks are the common case and should not shout.
            low, high = 0.0, 1.7
        image = ax.imshow(shown, aspect="auto", cmap=palette, vmin=low, vmax=high)
        ax.set_xticks([])
        ax.set_title(name, fontsize=8, rotation=25, ha="left", x=0.1)
        for row, value in enumerate(values):
            color = image.cmap(image.norm(value)) if np.isfinite(value) else (1, 1, 1, 1)
            dark = 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2] < 0.5
            text = format(value, spec) if np.isfinite(value) else "-" if spec == ".1f" else "undef."
            ax.text(0, row, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
        for spine in ax.spines.values():
            spine.set_visible(False)
    axes[0].set_yticks(range(len(runs)), [run.name for run in runs], fontsize=8)
    for ax in axes:
        ax.tick_params(length=0)
    figure.tight_layout(w_pad=0.2)
    return figure
