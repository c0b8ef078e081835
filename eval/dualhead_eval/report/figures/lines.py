"""Lines of a sweep: runs of one mechanism along one of its settings, means over seeds, with the paper's points."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from dualhead_eval.paper.mechanism import Mechanism, mechanism_of
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.statistics.run import Run

#: What a run's line is about, and by which training, in words; None for a run that is on no line.
Key = Callable[[Mechanism, Run], tuple[str, str] | None]
#: Styles of lines about one thing: by one training, by a second, by a third.
STYLES = ("-", ":", "-.")


@dataclass
class SweepLine:
    """Runs along a setting.

    Attributes:
        what: What it is about; lines about one thing have one colour.
        training: Network and budget behind it, empty for exact references.
        reference: Whether it is of exact references.
        runs: Runs by setting.
        paper: The paper's rho by setting, where it prints one.
    """

    what: str
    training: str
    reference: bool
    runs: dict[float, list[Run]] = field(default_factory=dict)
    paper: dict[float, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its label."""
        return self.what + (", exact" if self.reference else f", {self.training}" if self.training else "")

    @property
    def settings(self) -> list[float]:
        """Settings in order."""
        return sorted(self.runs)

    def values(self, setting: float, quantity: str) -> NDArray[np.float64]:
        """A quantity of the runs at a setting, those that define it."""
        found = np.array([getattr(run.first, quantity) for run in self.runs[setting]], dtype=np.float64)
        return found[np.isfinite(found)]

    def means(self, quantity: str) -> NDArray[np.float64]:
        """Mean over runs at every setting, NaN where none defines it."""
        return np.array([v.mean() if (v := self.values(s, quantity)).size else np.nan for s in self.settings])


def sweep_lines(runs: Iterable[Run], key: Key, setting: Callable[[Mechanism], float], *, least: int) -> list[SweepLine]:
    """Lines with ``least`` settings or more, in the order in which their first run appears.

    Args:
        runs: The runs; those at another operating point than their reference have no paper's points beside them.
        key: What a run's line is about, and by which training; exact references have lines of their own.
        setting: Where on the line a run lies; NaN for nowhere.
        least: Settings of a line that is worth drawing.
    """
    lines: dict[Hashable, SweepLine] = {}
    for run in runs:
        mechanism = mechanism_of(run.gate)
        names, at = key(mechanism, run), setting(mechanism)
        if names is None or not np.isfinite(at):
            continue
        line = lines.setdefault((*names, mechanism.reference), SweepLine(*names, mechanism.reference))
        line.runs.setdefault(at, []).append(run)
        printed = paper_row(mechanism.paper_row).get("rho")
        if run.at_reference and printed is not None and printed.value is not None:
            line.paper[at] = printed.value
    return [line for line in lines.values() if len(line.runs) >= least]


def colours(lines: Iterable[SweepLine]) -> dict[str, str]:
    """A colour for everything that lines are about; a reference has that of its trained runs."""
    about = list(dict.fromkeys(line.what for line in lines))
    return {what: f"C{number % 10}" for number, what in enumerate(about)}


def style_of(line: SweepLine, lines: Iterable[SweepLine]) -> str:
    """Dashed for a reference; lines about one thing by different trainings differ."""
    if line.reference:
        return "--"
    trainings = [other.training for other in lines if other.what == line.what and not other.reference]
    return STYLES[trainings.index(line.training) % len(STYLES)]


def draw_lines(ax: Axes, lines: Sequence[SweepLine], quantity: str, palette: dict[str, str], *, paper: bool) -> None:
    """Means over runs as lines, runs as dots, references dashed, the paper's as hollow diamonds."""
    for line in lines:
        colour, style, marker = palette[line.what], style_of(line, lines), "x" if line.reference else "o"
        ax.plot(line.settings, line.means(quantity), style, color=colour, marker=marker, markersize=4, label=line.name)
        for setting in line.settings:
            values = line.values(setting, quantity)
            if values.size > 1:
                ax.plot(np.full(values.size, setting), values, "o", color=colour, markersize=2.5, alpha=0.4)
        if paper and line.paper:
            at = sorted(line.paper)
            shown = [line.paper[setting] for setting in at]
            ax.plot(at, shown, "D", color=colour, markersize=6, fillstyle="none", linestyle="none")


def finish_rho(ax: Axes) -> None:
    """Axis, zero line and frame of a panel of rho."""
    ax.axhline(0, color="0.5", linewidth=0.8)
    ax.set_ylabel(r"$\rho$, mean over seeds (diamonds: the paper)")
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    finish(ax)


def finish(ax: Axes) -> None:
    """Frame and grid of a panel."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8)


def family_of(mechanism: Mechanism) -> str:
    """The mechanism in a few words, without environment and number of modes."""
    if mechanism.token is not None:
        return f"{mechanism.token} token, {'learned' if mechanism.learned_draw else 'uniform'} draw"
    if mechanism.latent is not None:
        weight = f", KL {mechanism.kl_weight:g}" if mechanism.latent == "posterior" else ""
        return f"{mechanism.latent} latent{weight}"
    noise = {1.0: "private noise", 0.0: "shared noise"}.get(mechanism.beta, f"noise beta {mechanism.beta:g}")
    return noise + (f", lambda {mechanism.consistency:g}" if mechanism.consistency else "")


def training_of(run: Run) -> str:
    """Which network and budget, in a few words; nothing for an exact reference."""
    record = run.training
    if record.reference or not record.network:
        return ""
    kind = "default network" if record.network.get("conditioning") == "film" else "the paper's network"
    return f"{kind}, {record.steps:,} steps" if record.steps else kind
