"""``dualhead report``: gate files (or a recorded dataset) to tables and figures.

Only the argument definitions are imported up front; everything else waits until the command runs.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from dualhead_eval.gate.gate import Gate
    from dualhead_eval.report.content import Row

DESCRIPTION = "Turn gate files into a table, JSON and figures, or print a recorded dataset's geometry card."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead report``."""
    parser.add_argument(
        "inputs",
        nargs="+",
        type=Path,
        metavar="GATE",
        help="gate files written by `dualhead evaluate`, folders of them, rollouts, or datasets written by `dualhead "
        "record`",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write every number to FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="also draw the attainable region")
    parser.add_argument(
        "--figures", type=Path, metavar="FOLDER", help="also draw every figure (region, forest, heat map, ...)"
    )
    parser.add_argument(
        "--html", type=Path, metavar="FILE.html", help="also write one self-contained page with everything"
    )
    parser.add_argument(
        "--paper",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="also print the runs beside the paper's rows, and its claims graded (default: for folders of gate files)",
    )
    parser.add_argument(
        "--every-quantity", action="store_true", help="with --paper: every quantity of every row, with intervals"
    )
    parser.add_argument(
        "--normalised",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="divide both axes of the region by 1 - 1/K (default: when the runs differ in K)",
    )
    parser.add_argument("--tau", type=float, help="threshold to report (default: each gate's reference)")
    parser.add_argument("--nfe", type=int, help="integration steps to report (default: each gate's reference)")
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")


def run(args: argparse.Namespace) -> int:
    """Print the report and write the files asked for.

    Raises:
        FileNotFoundError: If an input does not exist.
        FileExistsError: If an output exists and ``--overwrite`` was not given.
        ValueError: If an input is not a gate file or a dataset.
    """
    outputs = [args.json, args.figure, args.figures, args.html]
    for output in outputs:
        if output is not None and output.exists() and not args.overwrite:
            raise FileExistsError(f"{output} exists: choose another name or add --overwrite")

    from rich.console import Console

    from dualhead_envs.recording.card_table import render_card
    from dualhead_eval.atomic_text import write_text
    from dualhead_eval.evaluation.rollouts import render_closed_loop
    from dualhead_eval.report.content import explanation, render_table, report_json, report_rows
    from dualhead_eval.report.inputs import read_inputs
    from dualhead_eval.report.tables import render_all_heads, render_families

    console = Console()
    if not console.is_terminal:
        # A pipe or a file has no width of its own; the table needs about this much.
        console = Console(width=140)
    inputs = read_inputs(args.inputs)
    for folder, card in inputs.cards.items():
        console.print(render_card(card, title=f"Geometry card of {folder}"))
    gates = inputs.gates
    if not gates:
        if any(output is not None for output in outputs):
            raise ValueError("no gate file was given, expected at least one for the outputs asked for: add GATE files")
        if inputs.loops:
            console.print(render_closed_loop(inputs.loops))
        return 0
    rows = report_rows(gates, tau=args.tau, nfe=args.nfe)
    console.print(render_table(rows, explain=False))
    for table in (render_families(gates, rows), render_all_heads(gates)):
        if table is not None:
            console.print(table)
    console.print(explanation())
    if args.json is not None:
        write_text(args.json, json.dumps(report_json(rows), indent=2, allow_nan=False) + "\n")
        console.print(f"numbers written to {args.json}")
    if args.figure is not None:
        from dualhead_eval.report.figures.region import draw_region

        draw_region([row.summary for row in rows], args.figure, normalised=args.normalised)
        console.print(f"attainable region drawn in {args.figure}")
    if args.paper or (args.paper is None and inputs.from_folder):
        _print_beside_paper(console, gates, rows, every_quantity=args.every_quantity)
    if inputs.loops:
        console.print(render_closed_loop(inputs.loops))
    if args.figures is not None or args.html is not None:
        _draw_and_write(gates, rows, args)
        for output in (args.figures, args.html):
            if output is not None:
                console.print(f"written to {output}")
    return 0


def _print_beside_paper(console: Console, gates: list[Gate], rows: list[Row], *, every_quantity: bool) -> None:
    from dualhead_eval.paper.comparison import compare_sites, render_sites
    from dualhead_eval.report.tables import render_claims, render_comparisons

    sites = compare_sites(gates, rows)
    console.print()
    if sites:
        console.print(render_sites(sites))
    else:
        console.print("None of these runs has the setting of a row in the paper.")
    if every_quantity:
        console.print()
        console.print(render_comparisons(gates, rows))
    console.print()
    console.print(render_claims(gates))


def _draw_and_write(gates: list[Gate], rows: list[Row], args: argparse.Namespace) -> None:
    """Draw every figure once, for the folder of PNGs, the page, or both."""
    from dualhead_eval.atomic_text import write_text
    from dualhead_eval.report.figures.figures import report_figures

    figures = report_figures(gates, rows, normalised=args.normalised)
    if args.figures is not None:
        args.figures.mkdir(parents=True, exist_ok=True)
        for name, png in figures.items():
            (args.figures / f"{name}.png").write_bytes(png)
    if args.html is not None:
        from dualhead_eval.paper.claims import grade_claims
        from dualhead_eval.paper.comparison import compare_sites
        from dualhead_eval.paper.numbers import compare_with_paper
        from dualhead_eval.report.page import report_page

        comparisons, sites = compare_with_paper(gates, rows), compare_sites(gates, rows)
        page = report_page(gates, rows, figures, comparisons, sites, grade_claims(gates))
        write_text(args.html, page)
