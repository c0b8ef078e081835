"""``dualhead study``: a study of the paper from its file to its verdict, resumable at any moment."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from dualhead_eval.commands.console import open_console
from dualhead_eval.commands.counts import require_counts

if TYPE_CHECKING:
    from dualhead_eval.studies.study_plan import StudyPlan

DESCRIPTION = """\
Run a study: train what is missing, evaluate every checkpoint that it asks for, and say what it shows beside the
paper and the exact reference, by the criteria that its file fixes. A study knows its results by its gate files:
a finished one trains nothing; repeat the command to go on after an interruption.

  dualhead study ring-factorial
  dualhead study ring-factorial --preset smoke      the same in minutes, with a fraction of everything
  dualhead study v2-atlas --verdict-only            no training: what the gate files at hand show
  dualhead study studies/mine.yaml --data D

docs/studies.md lists the studies, their results, and the fields of a study's file.
"""
#: Where the studies of this repository lie.
STUDIES = Path("studies")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead study``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("study", metavar="NAME", help="studies/NAME.yaml, or the path of a study's file")
    parser.add_argument("--preset", choices=["smoke"], help="smoke: the study's smallest form, in minutes")
    parser.add_argument("--data", type=Path, help="folder of the datasets by name; recorded if missing (default: data)")
    parser.add_argument(
        "--results", type=Path, help="folder of gate files, tables and figures (default: results/studies)"
    )
    parser.add_argument("--runs", type=Path, help="folder of the training runs (default: outputs/studies)")
    parser.add_argument("--jobs", type=int, default=2, help="groups of runs or evaluations at a time (default: 2)")
    parser.add_argument("--stack", type=int, default=16, help="runs that train as one program at most (default: 16)")
    parser.add_argument("--precision", choices=["fp32", "tf32", "bf16"], default="fp32", help="as in `dualhead sweep`")
    parser.add_argument(
        "--importance", type=int, metavar="N", help="only what the study counts as this important or more (1: first)"
    )
    parser.add_argument("--later", action="store_true", help="also what the study marks as `later`")
    parser.add_argument("--verdict-only", action="store_true", help="train and evaluate nothing")
    packing = parser.add_mutually_exclusive_group()
    packing.add_argument(
        "--pack", action="store_true", help="afterwards put the gate files of its datasets into one file a dataset"
    )
    packing.add_argument("--unpack", action="store_true", help="first make gate files of its datasets' packs again")
    parser.add_argument("--no-progress", action="store_true", help="do not draw progress bars")


def run(args: argparse.Namespace) -> int:
    """Do what is missing and print the verdict.

    Raises:
        FileNotFoundError: If there is no such study.
        ValueError: If it contradicts itself, or a gate file is not what it asks for.
    """
    require_counts(args, "jobs", "stack")
    if args.importance is not None and args.importance < 1:
        raise ValueError(f"--importance {args.importance} is none: give 1 for what comes first, up to 9 for everything")
    from dualhead_eval.studies.smoke_study import smoke_study
    from dualhead_eval.studies.study_file import read_study
    from dualhead_eval.studies.study_plan import plan_study

    path = study_path(args.study)
    study, smoke = read_study(path), args.preset == "smoke"
    plan = plan_study(study, smoke=smoke, later=args.later)
    if smoke:
        study = smoke_study(study)

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    from dualhead_eval.report.terminal import render_table
    from dualhead_eval.studies.closed_loop_table import closed_loop_table
    from dualhead_eval.studies.gate_store import recordings
    from dualhead_eval.studies.packed_gates import pack_gates, unpack_gates
    from dualhead_eval.studies.residual_table import residual_table
    from dualhead_eval.studies.sensitivity_table import sensitivity_table
    from dualhead_eval.studies.study import StudyFolders, judge_study, missing_lines
    from dualhead_eval.studies.study_verdict import cells_table, grades_table
    from dualhead_eval.studies.study_work import Workplace, do_missing_work
    from dualhead_eval.studies.third_head_table import third_head_table

    scratch = Path("outputs") / "studies-smoke"
    folders = StudyFolders(args.results or (scratch / "results" if smoke else Path("results") / "studies"), path.stem)
    data = args.data or (scratch / "data" if smoke else Path("data"))
    console = open_console()
    if args.unpack and (count := unpack_gates(folders.gates, study.datasets)):
        console.print(f"{count} gates unpacked in {folders.gates}")
    if not args.verdict_only:
        place = Workplace(
            data,
            args.runs or (scratch / "runs" if smoke else Path("outputs") / "studies"),
            folders.gates,
            folders.closed_loops,
            jobs=args.jobs,
            stack=args.stack,
            precision=args.precision,
            show_progress=not args.no_progress,
        )
        from dualhead_eval.studies.shared_checkpoints import share_checkpoints

        shared = share_checkpoints(plan, _plans_beside(path, smoke=smoke))
        do_missing_work(shared, place, console.print, args.importance)
    if args.pack and (count := pack_gates(folders.gates, study.datasets)):
        console.print(f"{count} gate files packed in {folders.gates}")
    verdict = judge_study(study, plan, folders, data)
    if verdict.cells:
        console.print(render_table(cells_table(verdict.cells, verdict.references, study.title)))
    if (residuals := residual_table(verdict.cells)) is not None:
        console.print(render_table(residuals))
    if (scanned := sensitivity_table(verdict.cells)) is not None:
        console.print(render_table(scanned))
    if (third := third_head_table(verdict.cells)) is not None:
        console.print(render_table(third))
    if (driven := closed_loop_table(verdict.loops)) is not None:
        console.print(render_table(driven))
    console.print(render_table(grades_table(verdict.grades, study.question)))
    if smoke:
        console.print(
            "This is the study's smoke form, a fraction of everything: it shows that it runs, not what is so."
        )
    asked, missing, loops = plan.evaluations, verdict.missing, verdict.missing_loops
    console.print(f"{len(asked) - len(missing)} of {len(asked)} evaluations are there")
    if plan.loops:
        console.print(f"{len(plan.loops) - len(loops)} of {len(plan.loops)} closed loops are there")
    if args.importance is not None:  # name what this call would do; the rest was not asked for
        asked = tuple(one for one in asked if one.importance <= args.importance)
        missing = [one for one in missing if one.importance <= args.importance]
        loops = [one for one in loops if one.importance <= args.importance]
        console.print(f"of importance {args.importance} or more: {len(asked) - len(missing)} of {len(asked)}")
    for line in missing_lines(missing, loops):
        console.print(f"  {line}")
    for dataset, fingerprints in recordings(result for cell in verdict.cells for result in cell.results).items():
        if len(fingerprints) > 1:
            console.print(
                f"{dataset}: the same demonstrations recorded on {len(fingerprints)} kinds of processor, which differ "
                f"in their last bits (training_fingerprint in the table: {', '.join(x[:8] for x in fingerprints)})"
            )
    if verdict.table is not None:
        figure = verdict.figure or "none, no seed can be read"
        console.print(f"table:  {verdict.table}\nfigure: {figure}\ngates:  {folders.gates}")
    return 0


def _plans_beside(path: Path, *, smoke: bool) -> Iterator[StudyPlan]:
    """Plans of the other studies beside a study's file; what is no study, or contradicts itself, has no say."""
    from dualhead_eval.studies.study_file import read_study
    from dualhead_eval.studies.study_plan import plan_study

    for other in sorted({*path.parent.glob("*.yaml"), *path.parent.glob("*.yml")}):
        if other.resolve() != path.resolve():
            with suppress(OSError, ValueError):
                yield plan_study(read_study(other), smoke=smoke)


def study_path(name: str) -> Path:
    """The file of a study by its name or path.

    Raises:
        FileNotFoundError: If there is none; says which there are.
    """
    given = Path(name)
    if given.suffix in (".yaml", ".yml"):
        return given
    path = STUDIES / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in STUDIES.glob("*.yaml"))) or "no studies/*.yaml is in this folder"
        raise FileNotFoundError(
            f"there is no study {name!r} ({known}): give one of these, or the path of a study's file"
        )
    return path
