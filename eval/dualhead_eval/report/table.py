"""A table as plain cells: what a terminal and a page render each in its own way."""

from __future__ import annotations

from dataclasses import dataclass

from dualhead_eval.statistics.bootstrap import Equivalence
from dualhead_eval.statistics.interval import Interval

RHO = "\N{GREEK SMALL LETTER RHO}"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: Heading.
        meaning: What the column holds, printed beneath the table; empty where the heading says it.
        text: Whether it holds words, aligned left and broken where space is scarce, rather than numbers.
        detail: Whether a terminal, which is narrow, leaves it out.
    """

    name: str
    meaning: str = ""
    text: bool = False
    detail: bool = False


#: A column of every table that prints a rho: no effect is read without it.
LOSS = Column(
    "loss",
    "whether the flow loss had settled (the last tenth of its log within 1% of the tenth before) or was still falling;"
    " (total): judged on all terms together",
    text=True,
)


READING = Column("reading", text=True)


@dataclass(frozen=True)
class Cell:
    """A cell that a reader should not miss."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes:
        title: What it answers.
        columns: Its columns, what is looked for first on the left.
        rows: Lines of as many cells as columns; :class:`Cell` marks a warning.
        scope: What all lines share, for example their operating point.
        notes: Remarks beneath it.
        legend: Words of the cells, and what they mean.
        every_quantity: Whether a terminal leaves it out unless every quantity is asked for.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    scope: str = ""
    notes: tuple[str, ...] = ()
    legend: tuple[tuple[str, str], ...] = ()
    every_quantity: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.title!r} has a row of {len(row)} cells, expected {len(self.columns)}")


def printable(text: str) -> str:
    """Text whose control codes are spelled out, so that a label can neither move a cursor nor colour a terminal."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def number(value: float | None, spec: str) -> str:
    """A number in a format, ``undefined`` for NaN, ``-`` where there is none."""
    if value is None:
        return "-"
    return "undefined" if value != value else format(value, spec)


def bounds(interval: Interval | None, spec: str) -> str:
    """An interval in brackets, without spaces, so that it moves to a second line as a whole."""
    if interval is None:
        return ""
    if interval.low != interval.low:
        return "[undefined]"
    if not spec.endswith("%"):
        return f"[{interval.low:{spec}},{interval.high:{spec}}]"
    spec = spec.replace("%", "f")
    return f"[{100 * interval.low:{spec}},{100 * interval.high:{spec}}]"


def with_bounds(value: float, interval: Interval | None, spec: str) -> str:
    """A number with its interval."""
    if value != value:
        return "undefined"
    return f"{value:{spec}} {bounds(interval, spec)}".rstrip()


def equivalence(test: Equivalence | None) -> str:
    """Whether zero within the margin is established, and the smallest band that is."""
    if test is None or test.equivalent is None:
        return "undefined"
    return f"{'yes' if test.equivalent else 'no'} ±{test.width:.1%}"
