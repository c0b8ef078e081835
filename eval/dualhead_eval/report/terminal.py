"""Tables of a report on a terminal. Cells are text: nothing in them is taken for markup."""

from __future__ import annotations

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from dualhead_eval.report.table import Cell, Table, printable

#: Words up to this length are kept whole; longer ones, such as labels of runs, are broken where space is scarce.
_SHORTEST_TEXT = 15


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
        lines = RichTable(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for index in shown:
            column, texts = table.columns[index], _texts(table, index)
            if column.text:
                shortest = min(_SHORTEST_TEXT, _longest_word(texts))
                lines.add_column(_text(column.name), overflow="fold", min_width=shortest)
            else:
                # A number may move to a second line away from its interval; neither is ever broken.
                lines.add_column(_text(column.name), justify="right", min_width=_longest_word(texts))
        for row in table.rows:
            lines.add_row(*(_cell(row[index]) for index in shown))
        parts.append(lines)
    parts += [_text(note) for note in table.notes]
    meanings = [(table.columns[index].name, table.columns[index].meaning) for index in shown]
    meanings = [(name, meaning) for name, meaning in [*meanings, *table.legend] if meaning]
    if explain and meanings and table.rows:
        parts.append(_meanings(meanings))
    return Group(*parts, "")


def _meanings(meanings: list[tuple[str, str]]) -> RichTable:
    grid = RichTable.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column()
    for name, meaning in meanings:
        grid.add_row(_text(name, "bold"), _text(meaning))
    return grid


def _cell(cell: str | Cell) -> Text:
    return _text(cell.text, "bold yellow") if isinstance(cell, Cell) else _text(cell)


def _text(content: str, style: str = "") -> Text:
    return Text(printable(content), style=style)


def _texts(table: Table, index: int) -> list[str]:
    cells = [row[index] for row in table.rows]
    return [table.columns[index].name, *(cell.text if isinstance(cell, Cell) else cell for cell in cells)]


def _longest_word(texts: list[str]) -> int:
    return max(len(word) for text in texts for word in text.split() or [""])
