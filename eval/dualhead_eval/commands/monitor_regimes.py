"""``dualhead monitor regimes``: where disagreement costs false alarms, and when a shared token takes them away."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from dualhead_eval.commands.console import open_console

DESCRIPTION = """\
On the ring, with the best possible heads (no training): false alarms of the residual over prior, token entropy,
obedience and separation of the modes, beside their prediction; the registered criteria (docs/monitor_registration.md).

  dualhead monitor regimes --output outputs/regimes

Writes cells.csv, criteria.json and regimes.png; minutes of one core. Nothing is resumed.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead monitor regimes``."""
    parser.description = DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder to write")
    parser.add_argument(
        "--definition", type=Path, metavar="FILE", help="another sweep's YAML (default: the registered one)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the sweep, and write and print what came of it.

    Raises:
        FileExistsError: If the output holds anything.
        FileNotFoundError: If the definition does not exist.
        ValueError: If it is none.
    """
    from dualhead_envs.recording.staging import refuse_occupied
    from dualhead_eval.studies.monitor.regimes.definition import read_sweep

    sweep = read_sweep(args.definition)
    refuse_occupied(args.output)

    import torch
    from tqdm import tqdm

    from dualhead_envs.recording.staging import publish, staging_folder
    from dualhead_eval.atomic_text import write_bytes, write_text
    from dualhead_eval.report.figures.monitor import png
    from dualhead_eval.report.terminal import render_table
    from dualhead_eval.studies.monitor.regimes.figure import regime_figure
    from dualhead_eval.studies.monitor.regimes.grading import grade
    from dualhead_eval.studies.monitor.regimes.sweep import as_csv, run_sweep, sweep_length
    from dualhead_eval.studies.monitor.regimes.tables import regime_tables
    from dualhead_eval.studies.monitor.registration import registered

    torch.set_num_threads(1)  # small tensors
    with tqdm(total=sweep_length(sweep), unit="cell", desc="sweeping") as bar:
        swept = run_sweep(sweep, bar.update)
    gate = registered().gate
    graded = grade(sweep, swept, gate)
    named = [("", one) for one in swept.grid] + [(name, one) for name, both in swept.paper.items() for one in both]
    with staging_folder(args.output) as folder:
        made = folder / "regimes"
        write_text(made / "cells.csv", as_csv(named))
        document = {"definition": sweep.model_dump(mode="json"), "criteria": [vars(one) for one in graded]}
        write_text(made / "criteria.json", json.dumps(document, indent=1) + "\n")
        write_bytes(made / "regimes.png", png(regime_figure(sweep, swept, gate)))
        publish(made, args.output)
    console = open_console()
    for table in regime_tables(sweep, swept, graded, gate):
        console.print(render_table(table))
    console.print(f"cells, criteria, figure: {args.output}")
    return 0
