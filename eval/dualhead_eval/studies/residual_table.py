"""What the residual between the heads is made of, over a study's runs: ranges beside the paper's (tab:resid)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dualhead_eval.paper.mechanism import Mechanism, mechanism_of
from dualhead_eval.paper.numbers import paper_numbers
from dualhead_eval.report.table import Column, Table
from dualhead_eval.residuals.strata import ResidualSummary
from dualhead_eval.studies.study_cells import StudyCell

COMPONENT = "position"
COLUMNS = (
    Column("families", text=True),
    Column("runs", "training seeds of the families whose gate files keep residuals"),
    Column("same-mode mm", "mean distance of the heads' paths where both chose one mode: the floor"),
    Column("cross-mode mm", "the same where they chose two"),
    Column("mean mm", "over all valid pairs"),
    Column("mean / floor"),
    Column("cross-mode share %", "part of the residual's sum that pairs of two modes contribute"),
)
_QUANTITIES: tuple[tuple[str, Callable[[ResidualSummary], float], float, int], ...] = (
    ("residual_same_mm", lambda summary: summary.same, 1.0, 1),
    ("residual_cross_mm", lambda summary: summary.cross, 1.0, 1),
    ("residual_mm", lambda summary: summary.mean, 1.0, 1),
    ("residual_over_floor_ratio", lambda summary: summary.over_floor, 1.0, 2),
    ("cross_mode_share", lambda summary: summary.cross_share, 100.0, 1),
)


def _uncoordinated(mechanism: Mechanism) -> bool:
    return mechanism.token is None and mechanism.latent != "posterior" and mechanism.consistency == 0


def _strong_consistency(mechanism: Mechanism) -> bool:
    return mechanism.token is None and mechanism.latent is None and mechanism.consistency >= 3 and mechanism.beta == 0


#: Families of tab:resid and sec:share: name, the paper's row there, and which mechanisms they are.
FAMILIES: tuple[tuple[str, str, Callable[[Mechanism], bool]], ...] = (
    ("uncoordinated families", "uncoordinated families", _uncoordinated),
    ("strong consistency", "robot/strong consistency", _strong_consistency),
    ("episode tokens", "robot/episode tokens", lambda mechanism: mechanism.token == "episode"),
    (
        "window tokens and oracle",
        "robot/window tokens and oracle",
        lambda mechanism: mechanism.token in ("oracle", "window"),
    ),
)


def residual_table(cells: Sequence[StudyCell]) -> Table | None:
    """Ranges over runs, families as in the paper; None where no finished robot run of a study keeps residuals.

    Args:
        cells: A study's cells; the ends of runs on the robots are read.
    """
    rows: list[tuple[str, ...]] = []
    for environment in ("v2", "v3"):
        for name, theirs, belongs in FAMILIES:
            found = [
                run.residuals[COMPONENT]
                for cell in cells
                if cell.final
                for run in cell.runs
                if COMPONENT in run.residuals
                and (mechanism := mechanism_of(run.gate)).environment == environment
                and mechanism.standard
                and belongs(mechanism)
            ]
            if found:
                ours = [_range([read(summary) * scale for summary in found], digits)
                        for _, read, scale, digits in _QUANTITIES]  # fmt: skip
                rows.append((f"{environment} {name}", str(len(found)), *ours))
                if printed := _printed(environment, theirs):
                    rows.append(printed)
    if not rows:
        return None
    return Table("What the residual is made of", COLUMNS, tuple(rows), scope="ranges over runs")


def _printed(environment: str, row: str) -> tuple[str, ...] | None:
    names = (row, f"{environment}/{row}")
    found = {n.quantity: n for n in paper_numbers() if n.source in ("tab:resid", "sec:share") and n.row in names}
    if not found:
        return None
    runs = next(iter(found.values())).n
    cells = []
    for quantity, _, scale, digits in _QUANTITIES:
        number = found.get(quantity)
        if number is None:
            cells.append("-")
        elif number.value is not None:
            cells.append(_range([number.value * scale], digits))
        else:
            cells.append(_range([bound * scale for bound in (number.low, number.high) if bound is not None], digits))
    return ("    the paper", "-" if runs is None else str(runs), *cells)


def _range(values: Sequence[float], digits: int) -> str:
    known = [value for value in values if value == value]
    if not known:
        return "-"
    low, high = f"{min(known):.{digits}f}", f"{max(known):.{digits}f}"
    return low if low == high else f"{low} to {high}"
