"""Figures of a monitor report: ROC by kind of perturbation, false alarms by flag, delays, one episode."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from sklearn.metrics import roc_curve

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.monitor.detection.comparison import Measure
from dualhead_eval.monitor.detection.concordance import FEWEST
from dualhead_eval.monitor.detection.detection import delays, largest_aggregates

#: What each figure shows.
CAPTIONS = {
    "roc": "Failures of each kind of perturbation against all successes, by the episode's largest aggregate.",
    "gap": "Share of successful episodes' decisions with an alarm, where two modes are open and elsewhere (95 %).",
    "delay": "Failures detected so many steps after the onset (Kaplan-Meier), under the fitted threshold.",
    "episode": "The failed episode whose aggregate rises most above the threshold: scores, aggregate, flags, alarm.",
}


def monitor_figures(
    logs: Sequence[AlarmLog], measured: Mapping[tuple[str, str], Mapping[str, Measure]]
) -> dict[str, bytes]:
    """The figures that these runs allow, by name, as PNG bytes.

    Args:
        logs: The runs.
        measured: Measures by run and signal.
    """
    figures = {"roc": roc_figure(logs), "delay": delay_figure(logs), "episode": episode_figure(logs)}
    if any("gap" in measures for measures in measured.values()):
        figures["gap"] = gap_figure(measured)
    return {name: png(figure) for name, figure in figures.items() if figure is not None}


def roc_figure(logs: Sequence[AlarmLog], signals: Sequence[str] = ()) -> Figure | None:
    """A panel per run and signal (of ``signals``, or all), a line per kind with enough failures; None without any."""
    panels = []
    for log in logs:
        kinds = np.array([_kind(stratum) for stratum in log.strata])
        lines = [k for k in np.unique(kinds) if ((kinds == k) & ~log.success).sum() >= FEWEST]
        if lines and log.success.any():
            panels += [(log, signal, kinds, lines) for signal in log.signals if not signals or signal in signals]
    if not panels:
        return None
    figure, axes = _grid(len(panels))
    for ax, (log, signal, kinds, lines) in zip(axes, panels, strict=False):
        largest = largest_aggregates(log, signal)
        # roc_curve refuses infinities; what diverged ranks above all others all the same.
        ranks = np.unique(largest, return_inverse=True)[1]
        for kind in lines:
            used = log.success | (kinds == kind)
            alarms, detected, _ = roc_curve(~log.success[used], ranks[used])
            ax.plot(alarms, detected, linewidth=1.2, label=f"{kind} ({(~log.success & (kinds == kind)).sum()})")
        ax.plot([0, 1], [0, 1], color="0.8", linewidth=0.8, zorder=0)
        ax.set_title(f"{log.label}: {signal}", fontsize=8)
        ax.set_xlabel("false alarms per episode", fontsize=7)
        ax.set_ylabel("failures detected", fontsize=7)
        ax.legend(fontsize=6, frameon=False)
    return figure


def gap_figure(measured: Mapping[tuple[str, str], Mapping[str, Measure]]) -> Figure:
    """A line per run and signal: the flagged rate and the other, with intervals."""
    rows = [(f"{label}: {signal}", m) for (label, signal), m in measured.items() if "gap" in m]
    figure = Figure(figsize=(6.5, 1.2 + 0.3 * len(rows)), dpi=160, layout="constrained")
    ax = figure.subplots()
    for row, (_, found) in enumerate(reversed(rows)):
        for name, shift, color in (("flagged", 0.12, "tab:red"), ("other", -0.12, "0.4")):
            interval = found[name].interval
            if np.isfinite(interval.low):
                ax.plot([interval.low, interval.high], [row + shift] * 2, color=color, linewidth=1.4)
            ax.plot(found[name].value, row + shift, "o", color=color, markersize=4, label=None if row else name)
    ax.set_yticks(range(len(rows)), [name for name, _ in reversed(rows)], fontsize=7)
    ax.set_xlabel("decisions with a false alarm", fontsize=8)
    ax.legend(fontsize=7, frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    return figure


def delay_figure(logs: Sequence[AlarmLog], signals: Sequence[str] = ()) -> Figure | None:
    """Share detected against steps after the onset; None where no failure has an onset."""
    lines = [
        (f"{log.label}: {signal}", delays(log, signal))
        for log in logs
        for signal in log.signals
        if not signals or signal in signals
    ]
    lines = [(name, late) for name, late in lines if late.steps.size]
    if not lines:
        return None
    figure = Figure(figsize=(5.5, 3.6), dpi=160, layout="constrained")
    ax = figure.subplots()
    for name, late in lines:
        steps = np.arange(int(late.steps.max()) + 1, dtype=np.float64)
        ax.step(steps, 1 - late.missed_after(steps), where="post", linewidth=1.2, label=f"{name} ({late.steps.size})")
    ax.set_xlabel("steps after the onset", fontsize=8)
    ax.set_ylabel("failures detected", fontsize=8)
    ax.set_ylim(0, 1)
    ax.legend(fontsize=6, frameon=False)
    return figure


def episode_figure(logs: Sequence[AlarmLog]) -> Figure | None:
    """The first run's first signal over its clearest failure; None without a failure."""
    log = logs[0]
    signal = log.signals[0]
    aggregates, marks = log.aggregates(signal), log.exceeded(signal)
    failed = [i for i, episode in enumerate(log.document.episodes) if not episode.success]
    if not failed:
        return None
    number = max(failed, key=lambda i: (marks[i].any(), aggregates[i].max()))
    episode, limit = log.document.episodes[number], log.limits_of(number, signal)
    figure = Figure(figsize=(6, 3.2), dpi=160, layout="constrained")
    ax = figure.subplots()
    ax.plot(episode.at, log.scores(signal)[number], ".", color="0.5", label="score")
    ax.plot(episode.at, aggregates[number], color="tab:blue", label="aggregate")
    ax.plot(episode.at, limit, color="tab:red", linewidth=1, label="threshold")
    for at, flagged in zip(episode.at, episode.flagged or [], strict=False):
        if flagged:
            ax.axvspan(at - 2, at + 2, color="tab:orange", alpha=0.25, linewidth=0)
    if marks[number].any():
        ax.axvline(episode.at[int(np.argmax(marks[number]))], color="tab:red", linestyle=":", label="alarm")
    if episode.onset is not None:
        ax.axvline(episode.onset, color="black", linestyle="--", linewidth=0.8, label="onset")
    ax.set_title(f"{log.label}, {episode.key} ({episode.stratum}): {episode.failure}", fontsize=8)
    ax.set_xlabel("control step", fontsize=8)
    ax.set_ylabel(signal, fontsize=8)
    ax.legend(fontsize=6, frameon=False)
    return figure


def _kind(stratum: str) -> str:
    return stratum.partition("@")[0].partition(":")[0]


def _grid(panels: int) -> tuple[Figure, np.ndarray]:
    columns = min(4, panels)
    rows = -(-panels // columns)
    figure = Figure(figsize=(2.4 * columns, 2.4 * rows), dpi=160, layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for ax in axes:
        ax.tick_params(labelsize=6)
    for ax in axes[panels:]:
        ax.set_visible(False)
    return figure, axes


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
