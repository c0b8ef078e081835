"""A study's figure: every cell's seeds beside the paper and the exact reference; curves where there are budgets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, NullLocator, PercentFormatter
from numpy.typing import NDArray

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.statistics.seeds import seed_t_interval
from dualhead_eval.studies.grading.printed_cells import printed_number
from dualhead_eval.studies.study_cells import StudyCell
from dualhead_eval.studies.study_file import Figure as Shown
from dualhead_eval.studies.study_plan import shown_budget
from dualhead_eval.studies.study_references import StudyReferences

#: Checkpoints or budgets of one row from which on it is drawn as a curve.
CURVE = 3
OURS, PAPER, EXACT, PARTIAL = "tab:blue", "tab:red", "black", "0.6"


@dataclass(frozen=True)
class Beside:
    """A number beside a cell's.

    Attributes:
        value: The number.
        label: What it is, for the legend.
        partial: Whether it is that of some of the cell's conditions only.
    """

    value: float
    label: str
    partial: bool = False


@dataclass(frozen=True)
class Quantity:
    """What a forest shows of every cell.

    Attributes:
        label: Its axis.
        values: The seeds that can be read.
        paper: The paper's number, None if it prints none.
        exact: What the seeds and the paper's number are held against, None if there is nothing.
    """

    label: str
    values: Callable[[StudyCell], NDArray[np.float64]]
    paper: Callable[[StudyCell], float | None]
    exact: Callable[[StudyCell], Beside | None]


def quantity(name: Shown, references: StudyReferences) -> Quantity:
    """rho beside the optimum of the loss, or C / max C beside that of the data's own mode frequencies."""
    if name != "capacity":

        def optimum(cell: StudyCell) -> Beside | None:
            return _optimum(cell, references)

        return Quantity(r"$\rho$", lambda cell: cell.values("rho"), _printed_rho, optimum)

    def datas_own(cell: StudyCell) -> Beside | None:
        own = cell.target_capacity / (1 - 1 / cell.n_modes)
        return Beside(own, "the data's own mode frequencies") if own == own else None

    return Quantity(
        "C / max C",
        lambda cell: np.array([run.first.capacity_relative for run in cell.valid], dtype=np.float64),
        lambda cell: printed_number(cell.runs[0].gate, "tab:collapse", "C_rel"),
        datas_own,
    )


def _optimum(cell: StudyCell, references: StudyReferences) -> Beside | None:
    found = references.find(cell)
    if found is None:
        return None
    if found.n_conditions == cell.runs[0].gate.n_conditions:
        return Beside(found.rho, "exact optimum")
    return Beside(found.rho, "exact optimum, on fewer conditions (the table counts them)", partial=True)


def draw_study(cells: Sequence[StudyCell], references: StudyReferences, path: Path, shown: Shown = "rho") -> None:
    """Draw a study into a PNG file.

    Args:
        cells: Its cells.
        references: Exact references at hand.
        path: The picture.
        shown: What of every cell.

    Raises:
        ValueError: If no cell has a defined rho.
    """
    figure = study_figure(cells, references, shown)
    from io import BytesIO

    from PIL import Image

    drawn, small = BytesIO(), BytesIO()
    figure.savefig(drawn, format="png", metadata={"Software": None})
    # A chart has few colours: a palette makes the file three times smaller.
    Image.open(drawn).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    write_bytes(path, small.getvalue())


def study_figure(cells: Sequence[StudyCell], references: StudyReferences, shown: Shown = "rho") -> Figure:
    """A forest of the cells at the end of their runs, or curves over steps where they are asked for and there are any.

    Raises:
        ValueError: If no cell has a defined rho.
    """
    drawn = [cell for cell in cells if cell.values("rho").size]
    if not drawn:
        raise ValueError("no cell has a defined rho, expected at least one to draw")
    if shown == "steps" and (curves := _curves(drawn)):
        return _curve_figure(curves, references)
    plotted = quantity(shown, references)
    return _forest_figure([cell for cell in cells if cell.final and plotted.values(cell).size], plotted)


def _printed_rho(cell: StudyCell) -> float | None:
    printed = paper_row(cell.paper_row).get("rho")
    return None if printed is None else printed.value


def _forest_figure(cells: Sequence[StudyCell], plotted: Quantity) -> Figure:
    figure = Figure(figsize=(9.5, 1.6 + 0.26 * len(cells)), dpi=130, layout=ConstrainedLayoutEngine())
    ax, valid = figure.subplots(1, 2, sharey=True, width_ratios=(4, 1))
    rows = np.arange(len(cells))[::-1]
    for row, cell in zip(rows, cells, strict=True):
        values = plotted.values(cell)
        ax.plot(values, np.full(values.size, row), "o", color=OURS, markersize=3, alpha=0.5, markeredgewidth=0)
        ax.plot(values.mean(), row, "|", color=OURS, markersize=11, markeredgewidth=2)
        if values.size > 1:
            interval = seed_t_interval(values)
            ax.plot([interval.low, interval.high], [row, row], color=OURS, linewidth=1.2)
        if (printed := plotted.paper(cell)) is not None:
            ax.plot(printed, row, "D", color=PAPER, markersize=5, fillstyle="none", label="paper")
        if (exact := plotted.exact(cell)) is not None:
            ax.plot(exact.value, row, "x", color=PARTIAL if exact.partial else EXACT, markersize=6, label=exact.label)
        rates = np.array([run.first.valid_rate for run in cell.runs])
        valid.plot(rates, np.full(rates.size, row), "o", color="0.3", markersize=3, alpha=0.6, markeredgewidth=0)
    ax.axvline(0, color="0.4", linewidth=0.8)
    labels = [cell.name if cell.bank == "frozen" else f"{cell.name} ({cell.bank})" for cell in cells]
    ax.set_yticks(rows, labels, fontsize=8)
    ax.set_ylim(-0.7, len(cells) - 0.3)
    _percent(ax.xaxis)
    ax.set_xlabel(f"{plotted.label}: seeds, mean and 95% t interval over seeds")
    valid.set_xlim(-0.03, 1.03)
    valid.set_xticks([0, 0.5, 1], ["0", ".5", "1"])
    valid.set_xlabel("valid pairs")
    for panel in (ax, valid):
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(axis="x", color="0.92")
        panel.set_axisbelow(True)
    _legend(figure, ax)
    return figure


def _curves(cells: Sequence[StudyCell]) -> dict[tuple[str, str], list[StudyCell]]:
    """Cells of a row over its steps, of rows that have enough of them."""
    rows: dict[tuple[str, str], list[StudyCell]] = {}
    bank = cells[0].bank
    for cell in cells:
        if cell.bank == bank:
            rows.setdefault((cell.dataset, cell.configuration), []).append(cell)
    ordered = {key: sorted(row, key=lambda cell: cell.step) for key, row in rows.items()}
    return {key: row for key, row in ordered.items() if len({cell.step for cell in row}) >= CURVE}


def _curve_figure(curves: dict[tuple[str, str], list[StudyCell]], references: StudyReferences) -> Figure:
    """rho over steps and rho against validity, a row of panels per dataset; shades are steps."""
    datasets = list(dict.fromkeys(dataset for dataset, _ in curves))
    figure = Figure(figsize=(11, 4.2 * len(datasets)), dpi=130, layout=ConstrainedLayoutEngine())
    panels = figure.subplots(len(datasets), 2, squeeze=False)
    names = list(dict.fromkeys(name for _, name in curves))
    families = list(dict.fromkeys(_family(name) for name in names))
    styles = {"": "-", "constant": "--", "paper network": ":"}
    for (over_steps, against_validity), dataset in zip(panels, datasets, strict=True):
        for (own, name), row in curves.items():
            if own != dataset:
                continue
            colour = f"C{families.index(_family(name)) % 10}"
            style = styles[_variant(name)]
            label = f"{_family(name)}, {_variant(name) or 'default'}"
            steps = [cell.step for cell in row]
            rho = np.array([cell.mean("rho") for cell in row])
            valid = [float(np.mean([run.first.valid_rate for run in cell.runs])) for cell in row]
            over_steps.plot(steps, rho, style, color=colour, marker="o", markersize=3, label=label)
            for cell in row:
                values = cell.values("rho")
                over_steps.plot(np.full(values.size, cell.step), values, "o", color=colour, markersize=2, alpha=0.35)
            against_validity.plot(valid, rho, style, color=colour, linewidth=1)
            sizes = 10 + 12 * np.arange(len(row))
            against_validity.scatter(valid, rho, s=sizes, color=colour, alpha=0.7, linewidths=0)
            exact = references.rho(row[-1])
            if exact is not None:
                over_steps.axhline(exact, color=colour, linewidth=0.8, alpha=0.7)
        _finish(over_steps, against_validity, dataset, sorted({cell.step for row in curves.values() for cell in row}))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return figure


def _finish(over_steps: Axes, against_validity: Axes, dataset: str, steps: Sequence[int]) -> None:
    over_steps.set_xscale("log")
    over_steps.set_xticks(steps, [shown_budget(step) for step in steps])
    over_steps.xaxis.set_minor_locator(NullLocator())
    over_steps.set_xlabel("training steps")
    over_steps.set_title(f"{dataset}: over steps (thin lines: the loss's optimum)", fontsize=10)
    against_validity.set_xlabel("valid pairs")
    against_validity.set_title(f"{dataset}: against validity (larger: later)", fontsize=10)
    for ax in (over_steps, against_validity):
        ax.axhline(0, color="0.4", linewidth=0.8)
        ax.set_ylabel(r"$\rho$, mean over seeds")
        _percent(ax.yaxis)
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="0.92")
        ax.set_axisbelow(True)


def _variant(name: str) -> str:
    """Which network and schedule a row's name says."""
    if name.endswith("_constant"):
        return "constant"
    return "paper network" if "paper_network" in name else ""


def _family(name: str) -> str:
    return name.removesuffix("_constant").removesuffix("_paper_network").replace("_", " ")


def _percent(axis: object) -> None:
    formatter = PercentFormatter(1, decimals=0)
    axis.set_major_formatter(FuncFormatter(lambda value, _: formatter.format_pct(value, 1)))  # type: ignore[attr-defined]


def _legend(figure: Figure, axis: Axes) -> None:
    """Ours, and what else is drawn: a study that the paper did not make has no marks of the paper's."""
    from matplotlib.lines import Line2D

    ours = Line2D([], [], color=OURS, marker="o", markersize=4)
    drawn = {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    handles = {"ours, seeds": ours} | drawn
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
