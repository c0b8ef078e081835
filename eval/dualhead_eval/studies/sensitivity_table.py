"""Thresholds and Euler steps: the effect at every operating point of a cell, beside tab:tau."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.report.table import RHO, Column, Table
from dualhead_eval.statistics.seeds import seed_t_interval
from dualhead_eval.studies.grading.grade import points
from dualhead_eval.studies.operating_points import OperatingPoint, is_scanned, operating_points
from dualhead_eval.studies.study_cells import StudyCell

_DELTA = "\N{GREEK CAPITAL LETTER DELTA}"
_SOURCES = ("tab:tau", "app:sensitivity")
COLUMNS = (
    Column("cell", "DATASET/CONFIGURATION-BUDGET", text=True),
    Column("tau", "threshold of the mode partition: m on v2, of the mode's distance on v3 and the ring"),
    Column("steps", "Euler steps of a sample"),
    Column("valid", "share of sampled pairs in which both heads reach a mode"),
    Column(f"{RHO} %", "mean over seeds, with the 95% t interval of the mean over seeds"),
    Column(f"{_DELTA} pooled", "the pooled effect, mean over seeds"),
    Column(f"{_DELTA}, paper", "tab:tau and app:sensitivity, one seed"),
    Column("valid, paper"),
)


def sensitivity_table(cells: Sequence[StudyCell]) -> Table | None:
    """A line per operating point of every cell that was evaluated at more than one; None without any."""
    rows = [_line(cell, point) for cell in cells if is_scanned(cell) for point in operating_points(cell)]
    if not rows:
        return None
    return Table("Thresholds and Euler steps", COLUMNS, tuple(rows), scope="means over seeds; the paper's is one seed")


def _line(cell: StudyCell, point: OperatingPoint) -> tuple[str, ...]:
    rho = point.values("rho")
    scanned = f"tau{point.tau:.2f}" if point.nfe == cell.runs[0].gate.reference_nfe else f"nfe{point.nfe}"
    printed = paper_row(f"{cell.paper_row}/{scanned}", _SOURCES)
    effect, valid = (printed[name].value if name in printed else None for name in ("delta_pooled", "valid_pair_rate"))
    return (
        cell.name,
        f"{point.tau:g}",
        f"{point.nfe}",
        f"{point.mean('valid_rate'):.3f}",
        "undefined" if not rho.size else points(rho.mean(), seed_t_interval(rho) if rho.size > 1 else None),
        f"{point.mean('delta_pooled'):+.3f}",
        "-" if effect is None else f"{effect:+.3f}",
        "-" if valid is None else f"{valid:.3f}",
    )
