"""Tables of a report on a terminal. Cells are text: nothing in them is taken for markup.

Where a terminal is too narrow for a table's columns, every line of the table becomes a block of its own.
"""

from __future__ import annotations

from rich import box
from rich.console import Console, ConsoleOptions, Group, JustifyMethod, RenderableType, RenderResult
from rich.table import Table as RichTable
from rich.text import Text

from dualhead_eval.report.table import Cell, Table, printable

#: Words up to the first of these lengths for which there is room are kept whole; labels of runs are longer.
_WHOLE_WORDS = (20, 15, 8)
#: Lines longer than this are broken, so that a column of sentences leaves room to the others.
_LONGEST_LINE = 60
#: Blanks that each column takes beside its cells.
_GAP = 2


def render_table(table: Table, *, explain: bool = True) -> Group:
    """A table for a terminal, with what its columns and words mean underneath.

    Args:
        table: Its plain cells; columns of detail are left out.
        explain: Print the meanings.
    """
    parts: list[RenderableType] = [_text(table.title, "italic")]
    if table.scope:
        parts.append(_text(f"({table.scope})", "italic"))
    shown = [index for index, column in enumerate(table.columns) if not column.detail]
    if table.rows:
        parts.append(_Fitted(table, shown))
    parts += [_text(note) for note in table.notes]
    meanings = [(table.columns[index].name, table.columns[index].meaning) for index in shown]
    meanings = [(name, meaning) for name, meaning in [*meanings, *table.legend] if meaning]
    if explain and meanings and table.rows:
        parts.append(_pairs([(_text(name, "bold"), _text(meaning)) for name, meaning in meanings]))
    return Group(*parts, "")


class _Fitted:
    """The shown columns side by side where they fit, one block per line otherwise."""

    def __init__(self, table: Table, shown: list[int]):
        self.table, self.shown = table, shown

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for longest in _WHOLE_WORDS:
            narrowest = [self._narrowest(index, longest) for index in self.shown]
            room = options.max_width - sum(narrowest) - _GAP * len(narrowest)
            if room >= 0:
                yield self._columns(self._widened(narrowest, room))
                return
        for row in self.table.rows:
            first, *others = self.shown
            yield Text.assemble(_cell(row[first]), style="bold")
            yield _pairs([(_text(f"  {self.table.columns[i].name}"), _cell(row[i])) for i in others])

    def _columns(self, widths: list[int]) -> RichTable:
        lines = RichTable(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for index, width in zip(self.shown, widths, strict=True):
            column = self.table.columns[index]
            justify: JustifyMethod = "left" if column.text else "right"
            lines.add_column(_text(column.name), justify=justify, overflow="fold", width=width)
        for row in self.table.rows:
            lines.add_row(*(_cell(row[index]) for index in self.shown))
        return lines

    def _widened(self, widths: list[int], room: int) -> list[int]:
        """The widths with the room given away: to numbers first, then a blank at a time where most is missing."""
        wanted = [min(_LONGEST_LINE, max(map(len, self._texts(index)))) for index in self.shown]
        widths = list(widths)
        for text in (False, True):
            columns = [k for k, index in enumerate(self.shown) if self.table.columns[index].text is text]
            while room and (missing := max((wanted[k] - widths[k] for k in columns), default=0)) > 0:
                widths[next(k for k in columns if wanted[k] - widths[k] == missing)] += 1
                room -= 1
        return widths

    def _texts(self, index: int) -> list[str]:
        return [self.table.columns[index].name, *(_cell(row[index]).plain for row in self.table.rows)]

    def _narrowest(self, index: int, longest: int) -> int:
        """Smallest width of a column: a number may stand above its interval, and neither is ever broken."""
        words = [word for text in self._texts(index) for word in text.split()]
        width = max(map(len, words), default=1)
        return min(width, longest) if self.table.columns[index].text else width


def _pairs(pairs: list[tuple[Text, Text]]) -> RichTable:
    grid = RichTable.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column()
    for name, meaning in pairs:
        grid.add_row(name, meaning)
    return grid


def _cell(cell: str | Cell) -> Text:
    return _text(cell.text, "bold yellow") if isinstance(cell, Cell) else _text(cell)


def _text(content: str, style: str = "") -> Text:
    return Text(printable(content), style=style)
