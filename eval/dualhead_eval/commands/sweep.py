"""``dualhead sweep``: configurations x datasets x seeds, trained together, resumable at any moment."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dualhead_eval.commands.counts import require_counts

DESCRIPTION = """\
Train every configuration of a YAML file with every seed on every dataset. Runs whose tensors have the same shapes
train as one program; each leaves the checkpoints and the log that `dualhead train` would have left. Repeat the
command to go on after an interruption: finished runs are not trained again.

  dualhead sweep sweeps/v2.yaml

with, for example,

  output: outputs/v2
  datasets: {v2: data/v2/train}
  configurations: [configs/v2/A_independent.yaml, configs/v2/G_consistency_3.yaml]
  seeds: [0, 1, 2]
  preset: full
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead sweep``."""
    parser.description = DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("sweep", type=Path, metavar="SWEEP.yaml", help="the sweep (docs/sweeps.md lists its fields)")
    parser.add_argument("--jobs", type=int, default=2, help="groups of runs at a time (default: 2)")
    parser.add_argument("--stack", type=int, default=16, help="runs that train as one program at most (default: 16)")
    parser.add_argument(
        "--precision",
        choices=["fp32", "tf32", "bf16"],
        default="fp32",
        help="type in which the velocity fields compute (default: fp32; docs/sweeps.md compares them)",
    )
    parser.add_argument(
        "--backend",
        choices=["local", "dask", "ray"],
        default="local",
        help="where the groups train: processes of this machine (default), or a cluster at --address",
    )
    parser.add_argument("--address", help="the cluster's scheduler, for example tcp://host:8786")
    parser.add_argument("--no-progress", action="store_true", help="do not draw a progress bar")


def run(args: argparse.Namespace) -> int:
    """Train what is missing and say what there is."""
    require_counts(args, "jobs", "stack")
    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    from dualhead_policy.training.sweep.run_sweep import run_sweep
    from dualhead_policy.training.sweep.sweep_file import expand, read_sweep

    sweep = read_sweep(args.sweep)
    output = Path(sweep.output)
    manifest = run_sweep(
        expand(sweep),
        output,
        jobs=args.jobs,
        size=args.stack,
        precision=args.precision,
        backend=args.backend,
        address=args.address,
        show_progress=not args.no_progress,
    )
    finished = sum(record.state == "finished" for record in manifest.runs.values())
    print(f"{finished} of {len(manifest.runs)} runs finished in {output}")
    for name, record in manifest.runs.items():
        if record.state == "failed":
            print(f"dualhead: error: run {name} failed: {record.error}", file=sys.stderr)
    return 0 if not any(record.state == "failed" for record in manifest.runs.values()) else 1
