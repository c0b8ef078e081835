"""A table as HTML that fits its page: a line is a row where there is room, and a card on a phone."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.report.table import Cell, Column, Table
from dualhead_eval.report.web.frame import folded, text

#: Rows of a table, below a heading of their own (empty: none).
Groups = Sequence[tuple[str, Sequence[tuple[str | Cell, ...]]]]

#: Words up to this length are kept whole; labels of runs are longer.
_WHOLE_WORD = 12
#: Width of a page, and least width of a table's first column, in digits.
_PAGE, _FIRST = 118, 22


def render_table(table: Table, *, level: int | None = 2, groups: Groups | None = None) -> str:
    """A table with what its columns mean underneath; columns of detail stand in a folded table of their own.

    Args:
        table: Its plain cells. They are text: their markup is escaped.
        level: Level of its heading, None without one.
        groups: Its rows under headings, in place of ``table.rows``.
    """
    parts = [] if level is None else [f"<h{level}>{text(table.title)}</h{level}>"]
    if table.scope:
        parts.append(f'<p class="note">{text(table.scope)}</p>')
    groups = groups if groups is not None else [("", table.rows)]
    if table.rows:
        shown = [index for index, column in enumerate(table.columns) if not column.detail]
        hidden = [index for index, column in enumerate(table.columns) if column.detail]
        parts += [_rows(table, block, groups) for block in _blocks(table, shown)]
        parts += [f'<p class="note">{text(note)}</p>' for note in table.notes]
        if meanings := [*_meanings(table.columns, shown), *table.legend]:
            parts.append(folded("What the columns and words mean", _definitions(meanings)))
        if hidden:
            names = ", ".join(table.columns[index].name for index in hidden)
            more = [_rows(table, block, groups) for block in _blocks(table, [0, *hidden])]
            more.append(_definitions(_meanings(table.columns, hidden)))
            parts.append(folded(f"More columns: {names}", "\n".join(more)))
    else:
        parts += [f'<p class="note">{text(note)}</p>' for note in table.notes]
    return "\n".join(parts)


def _rows(table: Table, shown: Sequence[int], groups: Groups) -> str:
    head = "".join(
        f'<th scope="col" class="{_kind(column)}" style="min-width: {_least(table, index)}ch">{text(column.name)}</th>'
        for index, column in enumerate(table.columns)
        if index in shown
    )
    bodies = []
    for label, rows in groups:
        heading = f'<th scope="rowgroup" colspan="{len(shown)}">{text(label)}</th>'
        lines = [f'<tr class="group">{heading}</tr>'] if label else []
        lines += [
            "<tr>" + "".join(_cell(row[index], table.columns[index]) for index in shown) + "</tr>" for row in rows
        ]
        kind = ' class="grouped"' if label else ""
        bodies.append(f"<tbody{kind}>\n" + "\n".join(lines) + "\n</tbody>")
    # A table laid out as blocks, as on a phone, is a table for a screen reader only where its role says so.
    return (
        f'<table role="table" aria-label="{text(table.title)}">\n<thead><tr>{head}</tr></thead>\n'
        + "\n".join(bodies)
        + "\n</table>"
    )


def _blocks(table: Table, shown: Sequence[int]) -> list[list[int]]:
    """The columns in as many tables as a page's width needs, each with the first column."""
    first, *others = shown
    start = max(_least(table, first), _FIRST)
    blocks, room = [[first]], _PAGE - start
    for index in others:
        width = _least(table, index)
        if width > room and len(blocks[-1]) > 1:
            blocks.append([first])
            room = _PAGE - start
        blocks[-1].append(index)
        room -= width
    return blocks


def _least(table: Table, index: int) -> int:
    """Width of a column, in digits: numbers are never broken, words are kept whole up to a length."""
    cells = [row[index] for row in table.rows]
    texts = [table.columns[index].name, *(cell.text if isinstance(cell, Cell) else cell for cell in cells)]
    longest = max((len(word) for content in texts for word in content.split()), default=1)
    return (min(longest, _WHOLE_WORD) if table.columns[index].text else longest) + 2


def _meanings(columns: Sequence[Column], shown: Sequence[int]) -> list[tuple[str, str]]:
    return [(columns[index].name, columns[index].meaning) for index in shown if columns[index].meaning]


def _definitions(meanings: Sequence[tuple[str, str]]) -> str:
    if not meanings:
        return ""
    items = "".join(f"<dt>{text(name)}</dt><dd>{text(meaning)}</dd>" for name, meaning in meanings)
    return f"<dl>{items}</dl>"


def _kind(column: Column) -> str:
    return "text" if column.text else "number"


def _cell(cell: str | Cell, column: Column) -> str:
    kind, content = (f"{_kind(column)} warn", cell.text) if isinstance(cell, Cell) else (_kind(column), cell)
    # A number may stand above its interval; neither is broken.
    words = content if column.text else content.split(" ")
    inner = text(content) if column.text else " ".join(f"<span>{text(word)}</span>" for word in words)
    return f'<td class="{kind}" data-name="{text(column.name)}">{inner}</td>'
