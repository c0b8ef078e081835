"""Three heads: the effect of every pair and the agreement of all three, beside the paper's (tab:pose)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualhead_eval.report.table import RHO, Column, Table
from dualhead_eval.statistics.head_agreement import HeadAgreement
from dualhead_eval.statistics.seeds import seed_t_interval
from dualhead_eval.studies.grading.grade import points, with_interval
from dualhead_eval.studies.grading.printed_cells import POSE_EFFECTS, printed_number
from dualhead_eval.studies.study_cells import StudyCell

_DELTA = "\N{GREEK CAPITAL LETTER DELTA}"
COLUMNS = (
    Column("cell", "DATASET/CONFIGURATION-BUDGET", text=True),
    Column("heads", "a pair of heads, or all three", text=True),
    Column("valid", "share of samples in which these heads reach a mode"),
    Column(f"{RHO} %", "mean over seeds, with the 95% t interval of the mean over seeds"),
    Column(_DELTA, "how much more often than chance a pair chooses one mode, with the interval over seeds"),
    Column(f"{_DELTA}, paper", "the paper's one seed (tab:pose)"),
    Column("agree", "share of valid samples in which all three choose one mode, with the interval over seeds"),
    Column("by chance", "the same if every head chose by its own frequencies under each condition"),
    Column("agree, paper"),
)


def third_head_table(cells: Sequence[StudyCell]) -> Table | None:
    """A line per pair of heads, and one for all; None where no finished cell has more than two heads."""
    rows = [line for cell in cells if cell.final and cell.runs[0].agreement for line in _lines(cell)]
    if not rows:
        return None
    return Table("Every pair of three heads", COLUMNS, tuple(rows), scope="means over seeds; the paper's is one seed")


def _lines(cell: StudyCell) -> list[tuple[str, ...]]:
    gate = cell.runs[0].gate
    lines: list[tuple[str, ...]] = []
    for first in cell.runs[0].pairs:
        pair = cell.of_heads(first.heads)
        theirs = printed_number(gate, "tab:pose", POSE_EFFECTS.get(first.heads, ""))
        delta = with_interval(pair.mean("delta"), pair.interval("delta"), "+.3f")
        printed = "-" if theirs is None else f"{theirs:+.3f}"
        rho = points(pair.mean("rho"), pair.interval())
        lines.append((cell.name, " - ".join(first.heads), f"{pair.valid_rate:.3f}", rho, delta, printed, "-", "-", "-"))
    found: list[HeadAgreement] = [run.agreement for run in cell.runs if run.agreement is not None]
    rates = np.array([one.rate for one in found])
    spread = seed_t_interval(rates) if rates.size > 1 else None
    agree = with_interval(float(rates.mean()), spread, ".3f")
    theirs = printed_number(gate, "tab:pose", "three_way_agreement")
    valid, chance = (float(np.mean([getattr(one, name) for one in found])) for name in ("valid_rate", "chance"))
    printed = "-" if theirs is None else f"{theirs:.3f}"
    lines.append((cell.name, "all three", f"{valid:.3f}", "-", "-", "-", agree, f"{chance:.3f}", printed))
    return lines
