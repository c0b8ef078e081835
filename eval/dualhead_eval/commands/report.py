"""``dualhead report``: gate files (or a recorded dataset) to tables and figures.

Only the argument definitions are imported up front; everything else waits until the command runs.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from dualhead_eval.commands.console import open_console, refuse_overwrite

if TYPE_CHECKING:
    from dualhead_eval.report.content import Report

DESCRIPTION = "Turn gate files into a table, JSON and figures, or print a recorded dataset's geometry card."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead report``."""
    parser.add_argument(
        "inputs",
        nargs="+",
        type=Path,
        metavar="GATE",
        help="gate files written by `dualhead evaluate`, packs or folders of them, rollouts, or datasets written by "
        "`dualhead record`",
    )
    parser.add_argument(
        "--only",
        default="*",
        metavar="PATTERN",
        help="of the gates in packs, those whose names match, for example '*-50k/*-frozen*' (default: all)",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write every number to FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="also draw the attainable region")
    parser.add_argument(
        "--figures", type=Path, metavar="FOLDER", help="also draw every figure (region, forest, heat map, ...)"
    )
    parser.add_argument(
        "--output",
        "--html",
        dest="html",
        type=Path,
        metavar="FILE.html",
        help="also write one self-contained page with everything, which needs no network",
    )
    parser.add_argument(
        "--paper",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="also print the runs beside the paper's rows, and its claims graded (default: for folders of gate files)",
    )
    parser.add_argument(
        "--every-quantity",
        action="store_true",
        help="also print the residual's parts and, with --paper, every quantity of every row with intervals",
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
    refuse_overwrite(outputs, overwrite=args.overwrite)

    from dualhead_envs.recording.card_table import render_card
    from dualhead_eval.report.content import make_report
    from dualhead_eval.report.inputs import read_inputs
    from dualhead_eval.report.sweep_lines import sweep_lines
    from dualhead_eval.report.tables import paper_tables, report_tables
    from dualhead_eval.report.terminal import render_table

    console = open_console()
    inputs = read_inputs(args.inputs, args.only)
    for folder, card in inputs.cards.items():
        console.print(render_card(card, title=f"Geometry card of {folder}"))
    for folder, manifest in inputs.sweeps.items():
        console.print(*sweep_lines(folder, manifest), sep="\n", markup=False, highlight=False)
    if not inputs.gates and any(output is not None for output in outputs):
        raise ValueError("no gate file was given, expected at least one for the outputs asked for: add GATE files")
    report = make_report(inputs.gates, inputs.loops, tau=args.tau, nfe=args.nfe)
    tables = report_tables(report)
    if args.paper or (args.paper is None and inputs.from_folder):
        tables += paper_tables(report)
    for table in tables:
        if args.every_quantity or not table.every_quantity:
            console.print(render_table(table))
    for written in _write(report, args):
        console.print(f"written to {written}")
    return 0


def _write(report: Report, args: argparse.Namespace) -> Iterator[Path]:
    """Write the files asked for, every figure drawn once; yields each path."""
    if args.json is not None:
        from dualhead_eval.atomic_text import write_text
        from dualhead_eval.report.content import report_json

        write_text(args.json, json.dumps(report_json(report), indent=2, allow_nan=False) + "\n")
        yield args.json
    if args.figure is not None:
        from dualhead_eval.report.figures.region import draw_region

        yield draw_region(report, args.figure, normalised=args.normalised)
    if args.figures is None and args.html is None:
        return
    from dualhead_eval.atomic_text import write_bytes, write_text
    from dualhead_eval.report.figures.figures import report_figures
    from dualhead_eval.report.page import report_page

    figures = report_figures(report, normalised=args.normalised)
    if args.figures is not None:
        for name, png in figures.items():
            write_bytes(args.figures / f"{name}.png", png)
        yield args.figures
    if args.html is not None:
        write_text(args.html, report_page(report, figures, normalised=args.normalised))
        yield args.html
