"""The monitor report as one self-contained HTML page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape

from dualhead_eval.report.figures.monitor import CAPTIONS
from dualhead_eval.report.page import render_table
from dualhead_eval.report.table import Table

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1200px; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; font-size: 0.85em; } .wide { overflow-x: auto; } .note { color: #555; }
th, td { padding: 0.25em 0.7em; text-align: right; border-bottom: 1px solid #ddd; vertical-align: top; }
figure img { max-width: 100%; } td.text, th.text { text-align: left; } td.warn { background: #fff3c4; }
dl { display: grid; grid-template-columns: max-content auto; gap: 0.2em 1em; font-size: 0.9em; } dd { margin: 0; }
"""


def monitor_page(tables: Sequence[Table], figures: Mapping[str, bytes], captions: Mapping[str, str] = CAPTIONS) -> str:
    """The page as one string; images are embedded, nothing is fetched.

    Args:
        tables: Its tables.
        figures: PNG bytes by name, see :func:`dualhead_eval.report.figures.monitor.monitor_figures`.
        captions: What each figure shows, by the same names.
    """
    body = "\n".join(
        [*(render_table(table) for table in tables), *(_figure(captions[name], png) for name, png in figures.items())]
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>Monitor report</title><style>{_STYLE}</style></head>\n"
        f"<body><h1>Failure monitors</h1>\n{body}\n</body></html>\n"
    )


def _figure(text: str, png: bytes) -> str:
    caption, data = escape(text), base64.b64encode(png).decode()
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )
