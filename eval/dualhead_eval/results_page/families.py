"""Every run beside the paper's row: the page's long table."""

from __future__ import annotations

from dualhead_eval.report.table import number
from dualhead_eval.results_page.folders import NamedRun, named_runs
from dualhead_eval.results_page.template import markdown_table, percent

COLUMNS = [
    "run", "steps", "valid, ours / paper", "rho, ours", "paper", "its seeds' spread", "loss",
    "residual mm, ours / paper", "same-mode mm", "site, ours / paper",
]  # fmt: skip
#: The paper's budget; at another, a collapsed posterior's site is not judged.
PAPER_STEPS = 50_000


def family_table(arguments: list[str]) -> str:
    """``families FOLDER[=NOTE] ...``: every run of the folders."""
    return markdown_table(COLUMNS, [_line(named) for named in named_runs(arguments)])


def _line(named: NamedRun) -> list[str]:
    run, beside = named.run, named.beside
    residual = run.residuals.get("position")
    theirs = {q: None if beside is None else beside.paper_value(q) for q in ("valid_pair_rate", "rho", "residual_mm")}
    same = "-" if residual is None else number(residual.same, ".1f")
    return [
        named.name,
        named.steps,
        f"{run.first.valid_rate:.3f} / {number(theirs['valid_pair_rate'], '.3f')}",
        named.rho,
        percent(theirs["rho"]),
        _spread(named),
        run.training.loss,
        f"{number(run.residual_mm, '.1f')} / {number(theirs['residual_mm'], '.1f')}",
        same,
        _site(named),
    ]


def _spread(named: NamedRun) -> str:
    beside = named.beside
    if beside is None or beside.spread is None:
        return "-"
    text = f"[{100 * beside.spread.low:+.1f}, {100 * beside.spread.high:+.1f}]"
    return f"{text} **outside**" if beside.within_spread is False else text


def _site(named: NamedRun) -> str:
    beside = named.beside
    if beside is None:
        return named.run.first.occupancy.site
    text = f"{beside.site} / {beside.paper_site}"
    if beside.agrees is not False:
        return text
    if "posterior" in beside.paper_name and named.run.training.steps != PAPER_STEPS:
        return f"{text}, not judged at this budget"
    return f"{text} (within its spread)" if beside.within_spread else f"{text} **differs**"
