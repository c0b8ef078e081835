"""``dualhead monitor converse``: no surcharge where the two ways are hardly apart, from demonstrations to verdicts."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dualhead_eval.commands.console import open_console
from dualhead_eval.commands.counts import require_counts

if TYPE_CHECKING:
    from dualhead_eval.studies.monitor.converse.protocol import ConverseBudget, Run

DESCRIPTION = """\
Where the two ways of the demonstrations are hardly apart, heads that choose apart must raise no more false alarms for
it; the surcharge must appear as the ways move apart. Record demonstrations without a wall and with side steps of 0 to
165 mm, train the arms, score them on held-out demonstrations, grade the registered criteria
(docs/monitor_registration.md). Repeat the command to go on where it was interrupted.

  dualhead monitor converse --preset smoke --output outputs/converse_smoke
  dualhead monitor converse --preset full --output outputs/converse
  dualhead monitor converse --preset full --output outputs/converse --amplitudes 0 20 165 --arms A --seeds 200
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead monitor converse``."""
    parser.description = DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--preset",
        choices=["smoke", "full"],
        default="smoke",
        help="smoke: one seed, 1,000 steps, four side steps, tests the pipeline (default); full: as registered",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder of the study")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time (default: 1)")
    parser.add_argument("--amplitudes", type=int, nargs="+", metavar="MM", help="make only runs of these side steps")
    parser.add_argument("--arms", nargs="+", metavar="NAME", help="make only runs of these arms")
    parser.add_argument("--seeds", type=int, nargs="+", metavar="S", help="make only runs of these training seeds")
    parser.add_argument("--only-grade", action="store_true", help="make nothing: grade what the folder holds")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write what the verdicts need, small, into DIR too")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="write the figure (.png), replacing an older one")


def _wanted(args: argparse.Namespace, budget: ConverseBudget) -> list[Run]:
    """The runs that the options choose."""
    wanted = budget.runs()
    for place, name in enumerate(("amplitudes", "arms", "seeds")):
        chosen, known = getattr(args, name), {run[place] for run in budget.runs()}
        if chosen is None:
            continue
        if not set(chosen) <= known:
            raise ValueError(f"--{name} {' '.join(map(str, chosen))}: expected some of {sorted(known)}")
        wanted = [run for run in wanted if run[place] in chosen]
    if not wanted:
        raise ValueError(
            "--amplitudes, --arms and --seeds together choose no run of the protocol: choose fewer of them"
        )
    return wanted


def run(args: argparse.Namespace) -> int:
    """Run the stages that are not done, and print what follows.

    Raises:
        FileExistsError: If a folder holds something else.
        FileNotFoundError: If there is nothing to grade.
        ValueError: If an option is unusable or a training failed.
    """
    require_counts(args, "jobs")
    if args.figure is not None and args.figure.suffix != ".png":
        raise ValueError(f"--figure {args.figure} should end in .png")
    from dualhead_eval.atomic_text import write_bytes
    from dualhead_eval.report.terminal import render_table
    from dualhead_eval.studies.monitor.converse.curve import curve, verdicts
    from dualhead_eval.studies.monitor.converse.figure import CAPTION, converse_figure
    from dualhead_eval.studies.monitor.converse.protocol import registered_converse
    from dualhead_eval.studies.monitor.converse.study import ConverseStudy
    from dualhead_eval.studies.monitor.converse.tables import converse_tables
    from dualhead_eval.studies.stages import stage

    protocol = registered_converse()
    budget = protocol.presets[args.preset]
    study = ConverseStudy(protocol, args.preset, args.output, jobs=args.jobs, wanted=_wanted(args, budget))
    if args.only_grade and not args.output.is_dir():
        raise FileNotFoundError(f"--output {args.output} is no folder: give one that holds scored runs")
    study.claim_folder()
    if not args.only_grade:
        with stage(study.console, 1, 4, "Record demonstrations."):
            study.record()
        with stage(study.console, 2, 4, "Train the arms."):
            study.train()
        with stage(study.console, 3, 4, "Score them on held-out demonstrations."):
            study.score()
    tallies = study.tallies()
    with stage(study.console, 4, 4, "Grade the registered criteria."):
        points = curve(tallies, protocol)
    console = open_console()
    for table in converse_tables(points, verdicts(points, protocol, budget), protocol, budget):
        console.print(render_table(table))
    if args.figure is not None:
        write_bytes(args.figure, converse_figure(points, protocol))
        console.print(f"figure: {args.figure}. {CAPTION}")
    if args.keep is not None:
        study.keep(args.keep)
        console.print(f"kept: {args.keep}")
    return 0
