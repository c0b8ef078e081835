"""A report as one self-contained HTML page: every table, the figures, and where the numbers come from."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from html import escape

from dualhead_eval.report.content import Report
from dualhead_eval.report.figures.figures import CAPTIONS
from dualhead_eval.report.table import Cell, Table, printable
from dualhead_eval.report.tables import paper_tables, report_tables

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1400px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.6em; } h2 { font-size: 1.2em; margin-top: 2.2em; }
table { border-collapse: collapse; font-size: 0.88em; margin: 0.6em 0; width: max-content; }
th, td { padding: 0.25em 0.7em; text-align: right; border-bottom: 1px solid #ddd; vertical-align: top; }
th { border-bottom: 2px solid #888; } td.text, th.text { text-align: left; }
td.number { white-space: nowrap; } td.text { max-width: 34em; }
td:first-child, th:first-child { position: sticky; left: 0; background: #fff; }
td.warn { background: #fff3c4; } .wide { overflow-x: auto; } figure { margin: 1.2em 0; }
figure img { max-width: 100%; } figcaption, .note { color: #555; font-size: 0.9em; }
details { margin: 0.5em 0; } pre { font-size: 0.8em; background: #f6f6f6; padding: 0.8em; overflow-x: auto; }
dl { display: grid; grid-template-columns: max-content auto; gap: 0.2em 1em; font-size: 0.9em; }
dt { font-weight: bold; } dd { margin: 0; }
"""


def report_page(report: Report, figures: Mapping[str, bytes]) -> str:
    """The page as one string; images are embedded, nothing is fetched.

    Args:
        report: What to say.
        figures: PNG bytes by name, see :func:`dualhead_eval.report.figures.figures.report_figures`.
    """
    sections = [render_table(table) for table in report_tables(report)]
    # The figures stand behind the first table, which says what they show.
    if figures:
        sections.insert(1, f"<h2>Figures</h2>\n{_figures(figures)}")
    sections += [render_table(table) for table in paper_tables(report)]
    if report.runs:
        sections.append(f"<h2>Where the numbers come from</h2>\n{_provenance(report)}")
    body = "\n".join(sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>Coordination report</title><style>{_STYLE}</style></head>\n"
        f"<body><h1>Coordination report</h1>\n{body}\n</body></html>\n"
    )


def render_table(table: Table) -> str:
    """A table as HTML, all its columns, with what they mean underneath. Cells are text: their markup is escaped."""
    parts = [f"<h2>{_text(table.title)}</h2>"]
    if table.scope:
        parts.append(f'<p class="note">{_text(table.scope)}</p>')
    if table.rows:
        head = "".join(f'<th class="{_kind(c.text)}">{_text(c.name)}</th>' for c in table.columns)
        lines = [
            "".join(_cell(cell, column.text) for cell, column in zip(row, table.columns, strict=True))
            for row in table.rows
        ]
        body = "".join(f"<tr>{line}</tr>\n" for line in lines)
        parts.append(f'<div class="wide"><table><tr>{head}</tr>\n{body}</table></div>')
    parts += [f'<p class="note">{_text(note)}</p>' for note in table.notes]
    meanings = [*((column.name, column.meaning) for column in table.columns if column.meaning), *table.legend]
    if table.rows and meanings:
        items = "".join(f"<dt>{_text(name)}</dt><dd>{_text(meaning)}</dd>" for name, meaning in meanings)
        parts.append(f"<dl>{items}</dl>")
    return "\n".join(parts)


def _text(content: str) -> str:
    return escape(printable(content))


def _kind(text: bool) -> str:
    return "text" if text else "number"


def _cell(cell: str | Cell, text: bool) -> str:
    kind, content = (f"{_kind(text)} warn", cell.text) if isinstance(cell, Cell) else (_kind(text), cell)
    return f'<td class="{kind}">{_text(content)}</td>'


def _figures(figures: Mapping[str, bytes]) -> str:
    parts = []
    for name, png in figures.items():
        data, caption = base64.b64encode(png).decode(), _text(CAPTIONS[name])
        parts.append(
            f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return "\n".join(parts)


def _provenance(report: Report) -> str:
    parts = []
    for run in report.runs:
        gate = run.gate
        facts = {"heads": list(gate.heads), "conditions": gate.n_conditions, "taus": gate.taus, "nfes": gate.nfes}
        text = json.dumps(facts | gate.provenance, indent=1, default=str)
        parts.append(f"<details><summary>{_text(run.name)}</summary><pre>{escape(text)}</pre></details>")
    return "\n".join(parts)
