"""The monitor report as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dualhead_eval.report.figures.monitor import CAPTIONS
from dualhead_eval.report.table import Table
from dualhead_eval.report.web.frame import document, pictures
from dualhead_eval.report.web.html_table import render_table


def monitor_page(tables: Sequence[Table], figures: Mapping[str, bytes], captions: Mapping[str, str] = CAPTIONS) -> str:
    """The page as one string; nothing in it is fetched.

    Args:
        tables: Its tables.
        figures: PNG bytes by name, see :func:`dualhead_eval.report.figures.monitor.monitor_figures`.
        captions: What each figure shows, by the same names.
    """
    body = [*(render_table(table) for table in tables), pictures(figures, captions)]
    return document("Monitor report", "<h1>Failure monitors</h1>\n" + "\n".join(body))
