"""``dualhead monitor study``: the registered experiment, from demonstrations to verdicts, in one folder."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dualhead_eval.commands.console import open_console
from dualhead_eval.commands.counts import require_counts

if TYPE_CHECKING:
    from dualhead_eval.studies.monitor.conclusions import Conclusions
    from dualhead_eval.studies.monitor.log_table import MonitorLog
    from dualhead_eval.studies.monitor.registration import Registration
    from dualhead_eval.studies.monitor.study import MonitorStudy

DESCRIPTION = """\
Does coordinating the two heads take the residual's false alarms away without losing failures, or does matching do so
alone? Record demonstrations, train the executor and the arms, record its episodes, score every arm on them, grade the
registered criteria (docs/monitor_registration.md). Repeat the command to go on where it was interrupted.

  dualhead monitor study --preset smoke --output outputs/monitor
  dualhead monitor study --preset full --data data/v2 --arms outputs/monitor_v2/v2 --output outputs/monitor
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead monitor study``."""
    parser.description = DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--env", choices=["v2", "v3"], default="v2", help="environment of the protocol (default: v2)")
    parser.add_argument(
        "--preset",
        choices=["smoke", "full"],
        default="smoke",
        help="smoke: two seeds, 3,000 steps, 120 episodes, tests the pipeline (default); full: as registered",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder of the study")
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="demonstrations of `dualhead record` (default: record)"
    )
    parser.add_argument(
        "--arms", type=Path, metavar="DIR", help="trained arms, DIR/ARM/seed-S, those missing left out (default: train)"
    )
    parser.add_argument(
        "--executor", type=Path, metavar="DIR", help="the trained policy that drives (default: train it)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time (default: 2)")
    parser.add_argument("--only-grade", action="store_true", help="make nothing: grade what the folder holds")
    parser.add_argument(
        "--beside", type=Path, metavar="DIR", help="the other environment's study: test both together (Holm's rule)"
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write what the verdicts need, small, into DIR too")
    parser.add_argument("--device", default="cpu", help="where arms are sampled (default: cpu)")


def run(args: argparse.Namespace) -> int:
    """Run the stages that are not done, and print what follows.

    Raises:
        FileExistsError: If the folder holds something else.
        FileNotFoundError: If a folder that is given does not exist.
        ValueError: If an option is unusable, or no arm is there.
    """
    require_counts(args, "jobs")
    for name in ("data", "arms", "executor", "beside"):
        given = getattr(args, name)
        if given is not None and not given.is_dir():
            raise FileNotFoundError(f"--{name} {given} is no folder: give one that exists, or leave it out")
    from dualhead_eval.report.terminal import render_table
    from dualhead_eval.studies.monitor.log_table import read_log
    from dualhead_eval.studies.monitor.paper_logs import first_logs
    from dualhead_eval.studies.monitor.paper_tables import paper_tables
    from dualhead_eval.studies.monitor.registration import registered
    from dualhead_eval.studies.monitor.study import LOG, MonitorStudy
    from dualhead_eval.studies.monitor.tables import study_tables
    from dualhead_eval.studies.stages import stage

    options: dict[str, Any] = {name: getattr(args, name) for name in ("data", "arms", "executor", "jobs", "device")}
    protocol = registered()
    study = MonitorStudy(protocol, args.env, args.preset, args.output, **options)
    other = None if args.beside is None else _other(args, protocol)
    study.claim_folder()
    if args.only_grade:
        log = read_log(args.output / LOG)
    else:
        log = _made(study)
    with stage(study.console, 5, 5, "Grade the registered criteria."):
        found = _conclude(study, log)
        beside: dict[str, Conclusions] = {}
        if other is not None:
            beside[other.env] = _conclude(other, read_log(other.root / LOG))
    console = open_console()
    tables = [
        *study_tables(log, found, protocol, beside),
        *paper_tables(*first_logs(log, study.scored(), study.observed(), protocol), found, protocol),
    ]
    for table in tables:
        console.print(render_table(table))
    if not args.only_grade:
        console.print(f"page: {study.write_page(tables, found)}")
    if args.keep is not None:
        study.keep(args.keep, log)
        console.print(f"kept: {args.keep}")
    return 0


def _other(args: argparse.Namespace, protocol: Registration) -> MonitorStudy:
    """The study of the other environment that ``--beside`` names."""
    from dualhead_eval.studies.monitor.study import MonitorStudy

    (env,) = (name for name in protocol.environments if name != args.env)
    study = MonitorStudy(protocol, env, args.preset, args.beside)
    if not study.is_claimed():
        raise ValueError(f"--beside {args.beside} holds no {args.preset} study of {env}: give that one's --output")
    return study


def _conclude(study: MonitorStudy, log: MonitorLog) -> Conclusions:
    from dualhead_eval.studies.monitor.conclusions import conclude

    return conclude(log, study.scored(), study.protocol, study.budget.seeds, study.later)


def _made(study: MonitorStudy) -> MonitorLog:
    """Run the stages up to the scores that are not done."""
    from dualhead_eval.studies.stages import stage

    with stage(study.console, 1, 5, "Record demonstrations."):
        study.record_demonstrations()
    with stage(study.console, 2, 5, "Train the executor and the arms."):
        study.train()
    with stage(study.console, 3, 5, "Record the executor's episodes."):
        log = study.log()
    with stage(study.console, 4, 5, f"Score the arms, {study.protocol.scoring.samples} pairs at every decision."):
        study.score(log)
        study.score_observations(log)
    return log
