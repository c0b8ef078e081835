"""One self-contained HTML page: tables, figures, the paper's numbers beside ours, graded claims, provenance."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from dualhead_eval.gate.gate import Gate
from dualhead_eval.paper.claims import Grade
from dualhead_eval.paper.comparison import SiteComparison, site_notes
from dualhead_eval.paper.numbers import Comparison
from dualhead_eval.report.content import EXPLANATION, RHO, Row
from dualhead_eval.report.figures.figures import CAPTIONS
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.bootstrap import Equivalence
from dualhead_eval.statistics.family_summary import family_rows
from dualhead_eval.statistics.head_agreement import all_heads_agreement
from dualhead_eval.statistics.seeds import benjamini_hochberg

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1100px; margin: 2em auto; padding: 0 1em;
} h1 { font-size: 1.6em; } h2 { font-size: 1.2em; margin-top: 2.2em; }
table { border-collapse: collapse; font-size: 0.88em; margin: 0.6em 0; }
th, td { padding: 0.25em 0.7em; text-align: right; border-bottom: 1px solid #ddd; vertical-align: top; }
th { border-bottom: 2px solid #888; } td:first-child, th:first-child, td.text, th.text { text-align: left; }
td.range { white-space: nowrap; }
td.warn { background: #fff3c4; } .wide { overflow-x: auto; } figure { margin: 1.2em 0; }
figure img { max-width: 100%; } figcaption, .note { color: #555; font-size: 0.9em; }
details { margin: 0.5em 0; } pre { font-size: 0.8em; background: #f6f6f6; padding: 0.8em; overflow-x: auto; }
dl { display: grid; grid-template-columns: max-content auto; gap: 0.2em 1em; }
dt { font-weight: bold; } dd { margin: 0; }
"""


def report_page(
    gates: Sequence[Gate],
    rows: Sequence[Row],
    figures: Mapping[str, bytes],
    comparisons: Sequence[Comparison],
    sites: Sequence[SiteComparison],
    grades: Sequence[Grade],
) -> str:
    """The page as one string; images are embedded, nothing is fetched."""
    sections = [
        ("Do the heads choose modes together?", _effects(rows) + _explanation()),
        ("Means over seeds", _families(gates, rows)),
        ("Figures", _figures(figures)),
        ("The residual between the two decodings", _residuals(gates)),
        ("More than two heads", _all_heads(gates)),
        ("Beside the paper's rows", _sites(sites)),
        ("Every quantity beside the paper's", _comparisons(comparisons)),
        ("The paper's claims on these runs", _grades(grades)),
        ("Where the numbers come from", _provenance(gates)),
    ]
    body = "\n".join(f"<h2>{escape(title)}</h2>\n{content}" for title, content in sections if content)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>Coordination report</title><style>{_STYLE}</style></head>\n"
        f"<body><h1>Coordination report</h1>\n{body}\n</body></html>\n"
    )


def _table(head: Sequence[str], lines: Iterable[Sequence[str]], text: Sequence[int] = (0,)) -> str:
    """An HTML table; cells are escaped here, columns in ``text`` are left-aligned, "! " marks a warning."""

    def cell(tag: str, index: int, content: str) -> str:
        kinds = ["text"] if index in text else ["range"] if content.startswith("[") else []
        if content.startswith("! "):
            kinds, content = [*kinds, "warn"], content[2:]
        attribute = f' class="{" ".join(kinds)}"' if kinds else ""
        return f"<{tag}{attribute}>{escape(content)}</{tag}>"

    def line(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(cell(tag, index, content) for index, content in enumerate(cells)) + "</tr>"

    return (
        '<div class="wide"><table>'
        + line("th", head)
        + "".join(line("td", cells) for cells in lines)
        + "</table></div>"
    )


def _figure(value: float, spec: str) -> str:
    return "undefined" if value != value else format(value, spec)


def _range(low: float, high: float, spec: str) -> str:
    return "undefined" if low != low else f"[{low:{spec}}, {high:{spec}}]"


def _equivalence(test: Equivalence) -> str:
    if test.equivalent is None:
        return "undefined"
    return f"{'yes' if test.equivalent else 'no'} (±{test.width:.2%})"


def _effects(rows: Sequence[Row]) -> str:
    # What a reader looks for first stands left; the page scrolls to the rest.
    head = ["run", "reading", "valid", RHO, "95%", f"|{RHO}| < 2%?", "C", "Delta", "95%", "obs", "BL", "C tight"]
    head += [f"p ({RHO} = 0), BH", "pooled Delta", "Simpson", "TV to data A/B", "heads", "K", "tau", "NFE"]
    p_values = np.array([row.summary.p_value for row in rows])
    # One family of tests: every run on the page whose rho is defined.
    defined = np.isfinite(p_values)
    if defined.any():
        p_values[defined] = benjamini_hochberg(p_values[defined])
    lines = []
    for row, p_value in zip(rows, p_values.tolist(), strict=True):
        s = row.summary
        delta, rho, test = s.intervals["delta"], s.intervals["rho"], s.equivalence
        lines.append(
            [
                s.label + (" (unbiased estimates)" if s.estimator == "unbiased" else ""),
                row.reading if row.readable else f"! {row.reading}",
                f"{s.valid_rate:.4f}",
                _figure(s.rho, "+.1%"),
                _range(rho.low, rho.high, "+.1%"),
                _equivalence(test),
                _figure(s.capacity, ".4f"),
                _figure(s.delta, "+.4f"),
                _range(delta.low, delta.high, "+.4f"),
                _figure(s.obs, ".4f"),
                _figure(s.bl, ".4f"),
                _figure(s.capacity_tight, ".4f"),
                _figure(p_value, ".2g"),
                _figure(s.delta_pooled, "+.4f"),
                _figure(s.simpson, "+.4f"),
                f"{s.tv_target_q:.3f} / {s.tv_target_p:.3f}" if s.tv_target_q == s.tv_target_q else "no target",
                " / ".join(s.heads),
                str(s.n_modes),
                f"{s.tau:g}",
                str(s.nfe),
            ]
        )
    return _table(head, lines, text=(0, 1, 16))


def _families(gates: Sequence[Gate], rows: Sequence[Row]) -> str:
    head = [
        "family",
        "seeds",
        "valid",
        "C",
        "Delta",
        "sd",
        RHO,
        "sd",
        "95% (t over seeds)",
        f"|{RHO}| < 2%?",
        "reading",
    ]
    lines = []
    for family in family_rows(gates, rows):
        s, interval, test = family.summary, family.rho_interval, family.equivalence
        lines.append(
            [
                s.label,
                str(len(s.runs)),
                _figure(s.mean["valid_rate"], ".4f"),
                _figure(s.mean["capacity"], ".4f"),
                _figure(s.mean["delta"], "+.4f"),
                _figure(s.sd["delta"], ".4f"),
                _figure(s.mean["rho"], "+.1%"),
                _figure(s.sd["rho"], ".2%"),
                "undefined" if interval is None else _range(interval.low, interval.high, "+.1%"),
                "undefined" if test is None else _equivalence(test),
                f"{s.occupancy.word} ({s.occupancy.site})",
            ]
        )
    return _table(head, lines, text=(0, len(head) - 1)) if lines else ""


def _explanation() -> str:
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(meaning)}</dd>" for name, meaning in EXPLANATION)
    return f"<dl>{items}</dl>"


def _figures(figures: Mapping[str, bytes]) -> str:
    parts = []
    for name, png in figures.items():
        data = base64.b64encode(png).decode()
        caption = escape(CAPTIONS[name])
        parts.append(
            f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return "\n".join(parts)


def _residuals(gates: Sequence[Gate]) -> str:
    head = ["run", "component", "unit", "mean", "same-mode", "cross-mode", "cross-mode share", "mean / floor"]
    head.append("AUROC")
    lines = []
    for gate in gates:
        for name, strata in gate.strata.items():
            s = summarise_strata(strata.at(gate.index()))
            lines.append(
                [
                    gate.label,
                    name,
                    s.unit,
                    *(_figure(value, ".2f") for value in (s.mean, s.same, s.cross)),
                    _figure(s.cross_share, ".1%"),
                    _figure(s.over_floor, ".2f"),
                    _figure(s.auroc, ".4f"),
                ]
            )
    return _table(head, lines, text=(0, 1, 2)) if lines else ""


def _all_heads(gates: Sequence[Gate]) -> str:
    lines = []
    for gate in gates:
        if len(gate.heads) > 2:
            agreement = all_heads_agreement(gate)
            low, high = agreement.interval.low, agreement.interval.high
            lines.append(
                [
                    gate.label,
                    ", ".join(gate.heads),
                    _figure(agreement.valid_rate, ".4f"),
                    _figure(agreement.rate, ".4f"),
                    _range(low, high, ".4f"),
                    _figure(agreement.chance, ".4f"),
                ]
            )
    head = ["run", "heads", "all valid", "all in one mode", "95%", "expected by chance"]
    return _table(head, lines, text=(0, 1)) if lines else ""


def _sites(sites: Sequence[SiteComparison]) -> str:
    if not sites:
        return ""
    head = ["run", "the paper's row", "valid, ours / paper", f"{RHO}, ours / paper", "difference"]
    head += ["residual mm, ours / paper", "site, ours / paper", "same site?"]
    lines = []
    for site in sites:
        cells = list(site.cells())
        lines.append([*cells[:-1], cells[-1] if site.agrees else f"! {cells[-1]}"])
    return _table(head, lines, text=(0, 1)) + "".join(f'<p class="note">{escape(n)}</p>' for n in site_notes(sites))


def _comparisons(comparisons: Sequence[Comparison]) -> str:
    if not comparisons:
        return "<p>None of these runs has the setting of a row in the paper.</p>"
    head = [
        "run",
        "the paper's row",
        "quantity",
        "ours",
        "95% (conditions)",
        "head-valid",
        "paper",
        "difference",
        "seeds",
    ]
    head.append("note")
    lines = []
    for c in comparisons:
        spec = ".1f" if c.quantity == "residual_mm" else ".4f"
        bounds = "" if c.interval is None else _range(c.interval.low, c.interval.high, spec)
        cells = [c.label, f"{c.row} ({c.source})", c.quantity, _figure(c.ours, spec), bounds]
        cells += ["" if c.head_valid is None else _figure(c.head_valid, spec), f"{c.paper:{spec}}"]
        lines.append([*cells, _figure(c.difference, "+" + spec), str(c.n or ""), c.note])
    note = (
        "The paper's values are means over its seeds; most of its rows use head-valid marginals, ours the exact ones."
    )
    return _table(head, lines, text=(0, 1, 2, 9)) + f'<p class="note">{escape(note)}</p>'


def _grades(grades: Sequence[Grade]) -> str:
    lines = [[grade.claim, grade.grade, grade.evidence, grade.criterion] for grade in grades]
    return _table(["claim", "on these runs", "evidence", "criterion"], lines, text=(0, 1, 2, 3)) if lines else ""


def _provenance(gates: Sequence[Gate]) -> str:
    parts = []
    for gate in gates:
        facts = {"heads": list(gate.heads), "conditions": gate.n_conditions, "taus": gate.taus, "nfes": gate.nfes}
        text = json.dumps(facts | gate.provenance, indent=1, default=str)
        parts.append(f"<details><summary>{escape(gate.label)}</summary><pre>{escape(text)}</pre></details>")
    return "\n".join(parts)
