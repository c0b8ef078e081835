"""A report as one self-contained HTML page, in the order in which a person reads it.

First the answer in two sentences, the attainable region and the effects; then what differs from the paper; then,
folded, everything else, to the provenance of every run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from html import escape

from dualhead_eval.report.answer import report_answer
from dualhead_eval.report.content import Report
from dualhead_eval.report.effects_table import effects_table
from dualhead_eval.report.figures.figures import CAPTIONS
from dualhead_eval.report.paper_tables import claims_table, differences_table
from dualhead_eval.report.run_groups import RunGroup, group_runs
from dualhead_eval.report.table import Table
from dualhead_eval.report.tables import families_table, paper_tables, report_tables
from dualhead_eval.report.web.frame import document, folded, pictures, section, text
from dualhead_eval.report.web.html_table import Groups, render_table
from dualhead_eval.report.web.region_svg import region_svg

QUESTION = "Do the heads choose modes together?"
#: Runs beyond which they are folded where the means over their seeds stand above.
_MANY = 30


def report_page(report: Report, figures: Mapping[str, bytes], *, normalised: bool | None = None) -> str:
    """The page as one string; nothing in it is fetched.

    Args:
        report: What to say.
        figures: PNG bytes by name, see :func:`dualhead_eval.report.figures.figures.report_figures`. The region is drawn
            anew, so that it answers to a pointer.
        normalised: Divide both axes of the region by 1 - 1/K. By default only when the runs differ in K.
    """
    shown: list[Table] = []
    parts = [f"<h1>{text(QUESTION)}</h1>"]
    if report.runs:
        answer = report_answer(report)
        parts += [f'<p class="answer">{text(answer.what)}</p>', f'<p class="answer">{text(answer.trust)}</p>']
        parts.append(region_svg(report, normalised=normalised))
        if (families := families_table(report)) is not None:
            shown.append(families)
            parts.append(render_table(families))
        shown.append(effects := effects_table(report))
        parts.append(_effects(report, effects))
        shown += [differences := differences_table(report), claims := claims_table(report)]
        parts += [
            "<h2>What differs from the paper</h2>",
            render_table(differences, level=3),
            render_table(claims, level=3),
        ]
    titles = {table.title for table in shown}
    details = [table for table in (*report_tables(report), *paper_tables(report)) if table.title not in titles]
    parts.append("<h2>Details</h2>")
    parts += [section(table.title, render_table(table, level=None)) for table in details]
    others = {name: png for name, png in figures.items() if name != "region"}
    if others:
        parts.append(section("Figures", pictures(others, CAPTIONS)))
    if report.runs:
        parts.append(section("Where the numbers come from", _provenance(report)))
    return document("Coordination report", "\n".join(part for part in parts if part))


def _effects(report: Report, table: Table) -> str:
    """The effects by group; folded where they are many and their means over seeds stand above."""
    groups = group_runs(report.runs)
    rows = dict(zip((id(pair) for pair in report.pairs), table.rows, strict=True))
    together: Groups = [(_heading(group), _members(group, rows)) for group in groups]
    if report.families and len(table.rows) > _MANY:
        return section(
            f"Every run and its effect ({len(table.rows)})", render_table(table, level=None, groups=together)
        )
    return render_table(replace(table, title="Every run and its effect"), groups=together)


def _heading(group: RunGroup) -> str:
    return group.label if len(group.runs) > 1 else ""


def _members(group: RunGroup, rows: Mapping[int, tuple]) -> list[tuple]:
    """The rows of a group; under a heading a run is named by what tells it from the others."""
    lines = []
    for run in group.runs:
        for pair in run.pairs:
            first, *others = rows[id(pair)]
            star = "*" if str(first).endswith("*") else ""
            lines.append((group.member(run) + star, *others) if len(group.runs) > 1 else (first, *others))
    return lines


def _provenance(report: Report) -> str:
    parts = []
    for run in report.runs:
        gate = run.gate
        facts = {"heads": list(gate.heads), "conditions": gate.n_conditions, "taus": gate.taus, "nfes": gate.nfes}
        content = json.dumps(facts | gate.provenance, indent=1, default=str)
        parts.append(folded(run.name, f"<pre>{escape(content)}</pre>"))
    return "\n".join(parts)
