"""``dualhead ensemble``: do the members of an ensemble choose modes together, and what do their scores measure?"""

from __future__ import annotations

import argparse
from pathlib import Path

from dualhead_eval.commands.console import open_console, refuse_overwrite

DESCRIPTION = """\
Sample one head of every member of an ensemble under the test conditions of a dataset, with private noise and
with one draw for all, and split what the members disagree about by their modes: Action-L2, and VFD with its
time weight and without.

  dualhead ensemble outputs/A/seed-0 outputs/A/seed-1 outputs/A/seed-2 --dataset data/v2/test --output ensembles/A
  dualhead report ensembles/A

Four gate files are written: private, shared, vfd and vfd_unweighted. A member is a checkpoint's folder or a training
run's output folder; members trained on the same data can be compared.
"""
#: Samples per condition on which VFD is computed where ``--vfd-pairs`` is not given.
VFD_PAIRS = 64


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead ensemble``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("members", nargs="+", metavar="DIR", help="the members' policies, two or more")
    parser.add_argument("--dataset", required=True, metavar="DIR", help="split with the test conditions")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="folder of the gate files")
    parser.add_argument("--label", help="name of the ensemble in tables (default: the output folder's name)")
    parser.add_argument("--head", choices=["position", "joint"], default="position", help="default: position")
    parser.add_argument("--pairs", type=int, help="samples per condition and member (default: 1280)")
    parser.add_argument(
        "--vfd-pairs",
        type=int,
        default=VFD_PAIRS,
        help=f"the same for VFD, whose fields are evaluated once for every member (default: {VFD_PAIRS})",
    )
    parser.add_argument("--conditions", type=int, help="use the first N conditions (default: all)")
    parser.add_argument("--nfe", type=int, help="Euler steps (default: 20)")
    parser.add_argument("--seed", type=int, help="seed of the draws (default: 0)")
    parser.add_argument("--overwrite", action="store_true", help="replace gate files that exist")


def run(args: argparse.Namespace) -> int:
    """Evaluate the ensemble, write its gate files and print what they say.

    Raises:
        FileExistsError: If a gate file exists and ``--overwrite`` was not given.
        FileNotFoundError: If a member or the dataset does not exist.
        ValueError: If a member is given twice, does not fit the conditions or the others, or an option is unusable.
    """
    if args.output.exists() and not args.output.is_dir():
        raise FileExistsError(f"{args.output} is a file, expected a folder for the gate files: choose another")
    scores = ("private", "shared", "vfd", "vfd_unweighted")
    files = {score: args.output / f"{score}.gate.json" for score in scores}
    refuse_overwrite(files.values(), overwrite=args.overwrite)

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    from tqdm import tqdm

    from dualhead_eval.ensembles.evaluation import evaluate_ensemble
    from dualhead_eval.ensembles.members import open_members
    from dualhead_eval.ensembles.velocity_disagreement import evaluate_velocity_disagreement
    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.protocol import EvaluationProtocol
    from dualhead_eval.gate import write_gate
    from dualhead_eval.report.ensemble_tables import contamination_table, ensemble_choices_table
    from dualhead_eval.report.terminal import render_table

    options = {name: getattr(args, name) for name in ("pairs", "seed") if getattr(args, name) is not None}
    if args.nfe is not None:
        options["nfes"] = (args.nfe,)
    protocol = EvaluationProtocol(**options)
    few = EvaluationProtocol(**options | {"pairs": args.vfd_pairs})
    members = open_members(args.members)
    conditions = open_conditions(args.dataset, args.conditions)
    label = args.label or args.output.absolute().name
    gates = {}
    with tqdm(total=3 * len(conditions), unit="condition", desc="private noise") as bar:
        for score, shared in (("private", False), ("shared", True)):
            bar.set_description(f"{score} noise")
            gates[score] = evaluate_ensemble(
                members, conditions, protocol, label, head=args.head, shared_noise=shared, progress=bar.update
            )
        bar.set_description("VFD")
        gates |= evaluate_velocity_disagreement(members, conditions, few, label, head=args.head, progress=bar.update)
    for score, file in files.items():
        write_gate(gates[score], file, overwrite=args.overwrite)

    console = open_console()
    ordered = [gates[score] for score in scores]
    for table in (ensemble_choices_table(ordered), contamination_table(ordered)):
        console.print(render_table(table))
    console.print(f"gate files in: {args.output}")
    return 0
