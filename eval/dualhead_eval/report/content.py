"""From gate files to a table that a newcomer can read: pure functions, no files.

One row per run and pair of heads, at the gate's reference threshold and integration steps unless told
otherwise. Every number is recomputed from the counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.gate.gate import Gate
from dualhead_eval.statistics.bootstrap import Interval
from dualhead_eval.statistics.run_summary import FEW_PAIRS, RunSummary, summarise_run

#: Valid-pair rate below which a run cannot be read, by partition. On the ring every expert path is valid,
#: so invalid samples mean an under-trained sampler, whose survivors inflate |rho|; on the robots they are
#: ordinary.
READABLE_VALID_RATE = {"ring": 0.95}

RHO = "\N{GREEK SMALL LETTER RHO}"

EXPLANATION = (
    (
        "valid",
        "share of sampled pairs in which both heads reach a mode; everything to its right is about these",
    ),
    (
        "C",
        "how much the heads could coordinate, given how varied each one is (0: one mode only, 1 - 1/K: all)",
    ),
    ("Δ", "how much more often than chance they choose the same mode (negative: less often)"),
    (RHO, "Δ / C: 0 independent, 1 always together; in brackets the 95% interval over conditions"),
    (
        f"{RHO} = 0?",
        f"whether |{RHO}| < 2% is established (two one-sided tests at 5%), and the smallest band that is",
    ),
)


@dataclass(frozen=True)
class Row:
    """One line of the report.

    Attributes:
        summary: The run's statistics for one pair of heads.
        partition: Name of the mode partition.
        readable: False if the valid-pair rate is too low for this partition to read rho.
        first_pair: Whether this is the gate's first pair of heads.
    """

    summary: RunSummary
    partition: str
    readable: bool
    first_pair: bool = True

    @property
    def reading(self) -> str:
        """What the row says, in plain words."""
        summary = self.summary
        if not self.readable:
            limit = READABLE_VALID_RATE[self.partition]
            return f"not yet readable: valid-pair rate below {limit:.2f}"
        if summary.occupancy is Occupancy.UNKNOWN:
            return f"not estimable: {summary.reason.split(':')[0]}"
        if summary.reason:
            return "collapsed: a head chose one mode in every condition"
        test = summary.equivalence
        if summary.occupancy is Occupancy.FLOOR and not test.equivalent:
            return f"uncoordinated within ±{test.width:.1%} (I)"
        if 0.0 in summary.intervals["rho"] and not test.equivalent:
            return f"unclear: the sign of {RHO} is not established"
        return f"{summary.occupancy.word} ({summary.occupancy.site})"


def report_rows(gates: Iterable[Gate], *, tau: float | None = None, nfe: int | None = None) -> list[Row]:
    """Rows of the report: every pair of heads of every gate.

    Raises:
        KeyError: If a gate does not hold the threshold or the number of steps asked for.
    """
    rows = []
    for gate in gates:
        partition = str(gate.partition.get("name", ""))
        for pair in combinations(range(len(gate.heads)), 2):
            summary = summarise_run(gate, heads=pair, tau=tau, nfe=nfe)
            enough = summary.valid_rate >= READABLE_VALID_RATE.get(partition, 0.0)
            rows.append(Row(summary, partition, enough, pair == (0, 1)))
    return rows


def render_table(gates: Sequence[Gate] | Sequence[Row], *, explain: bool = True) -> Group:
    """A rich table of the runs, with a line per column underneath.

    What all runs share (K, threshold, integration steps) stands in the title instead of in columns.

    Args:
        gates: Gates, or rows from :func:`report_rows`.
        explain: Print what each column means.
    """
    rows = [item for item in gates if isinstance(item, Row)]
    rows += report_rows(item for item in gates if isinstance(item, Gate))
    point = {
        "K": [str(row.summary.n_modes) for row in rows],
        "τ": [f"{row.summary.tau:g}" for row in rows],
        "NFE": [str(row.summary.nfe) for row in rows],
        "heads": [" / ".join(row.summary.heads) for row in rows],
    }
    varying = {name: cells for name, cells in point.items() if len(set(cells)) > 1}
    shared = ", ".join(f"{name} = {cells[0]}" for name, cells in point.items() if cells and name not in varying)
    table = Table(
        title="Do the heads choose modes together?" + (f"\n({shared})" if shared else ""),
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    table.add_column("run", overflow="fold", min_width=11)
    for name in varying:
        table.add_column(name, justify="right", overflow="fold")
    for name in ("valid", "C", "Δ"):
        table.add_column(name, justify="right", no_wrap=True)
    # No spaces inside an interval: on a narrow terminal it moves to a second line as a whole.
    table.add_column(f"{RHO} [95%]", justify="right", min_width=15)
    table.add_column(f"{RHO} = 0?", min_width=7)
    table.add_column("reading", overflow="fold", min_width=12)
    for index, row in enumerate(rows):
        s = row.summary
        name = s.label + ("*" if s.estimator == "unbiased" else "")
        cells: list[str | Text] = [name, *(column[index] for column in varying.values()), f"{s.valid_rate:.3f}"]
        cells += [_number(s.capacity, ".4f"), _number(s.delta, "+.4f"), _with_interval(s.rho, s.intervals["rho"])]
        cells += [_equivalence(s), Text(row.reading, style="" if row.readable else "bold yellow")]
        table.add_row(*cells)
    parts: list[Table | str] = [table]
    if any(row.summary.estimator == "unbiased" for row in rows):
        parts.append(f"* fewer than {FEW_PAIRS} pairs a condition: unbiased estimates, which can leave [-1, 1]")
    return Group(*parts, explanation()) if explain else Group(*parts)


def report_json(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """The rows as plain JSON objects; undefined numbers are null."""
    objects = []
    for row in rows:
        summary = asdict(row.summary)
        summary["occupancy"] = {
            "site": row.summary.occupancy.site,
            "word": row.summary.occupancy.word,
            "meaning": row.summary.occupancy.meaning,
        }
        summary |= {"partition": row.partition, "readable": row.readable, "reading": row.reading}
        summary["equivalence"]["verdict"] = row.summary.equivalence.verdict
        objects.append(_without_nan(summary))
    return objects


def explanation() -> Table:
    """What each column and each reading means."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for name, meaning in EXPLANATION:
        table.add_row(name, meaning)
    for site in (Occupancy.FLOOR, Occupancy.ORIGIN, Occupancy.INTERIOR, Occupancy.CORNER, Occupancy.NEGATIVE):
        table.add_row(f"{site.word} ({site.site})", site.meaning)
    return table


def _number(value: float, spec: str) -> str:
    return "undefined" if value != value else format(value, spec)


def _with_interval(value: float, interval: Interval) -> str:
    if value != value:
        return "undefined"
    if interval.low != interval.low:
        return f"{value:+.1%} [undefined]"
    return f"{value:+.1%} [{100 * interval.low:+.1f},{100 * interval.high:+.1f}]"


def _equivalence(summary: RunSummary) -> str:
    test = summary.equivalence
    if test.equivalent is None:
        return "undef."
    return f"{'yes' if test.equivalent else 'no'} ±{test.width:.1%}"


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and value != value else value
