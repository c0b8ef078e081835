"""The part of ``dualhead evaluate`` for tasks of one's own: a table of labels, or two prediction columns, to a gate."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dualhead_eval.gate import Gate


def add_own_inputs(what: argparse._ActionsContainer) -> None:
    """Define what may be given in place of a policy."""
    what.add_argument(
        "--labels",
        metavar="FILE",
        help="a .csv or .parquet table with the columns condition, label_a, label_b and, if known, episode and sample; "
        "modes from 0, -1 invalid",
    )
    what.add_argument(
        "--columns", nargs=2, metavar="FEATURE", help="two features of --dataset with predicted paths, see --partition"
    )


def add_own_options(parser: argparse.ArgumentParser) -> None:
    """Define what reading them takes."""
    own = parser.add_argument_group("your own task, with --columns or --labels")
    own.add_argument(
        "--partition",
        metavar="P",
        help="FILE.json describes one by side, crossing, reference or endpoint; endpoint:K clusters the predictions' "
        "end points; module:attribute runs code of yours",
    )
    own.add_argument("--horizon", type=int, metavar="H", help="steps of a prediction, where a feature is flat")
    own.add_argument("--metres", action="store_true", help="paths are in metres: count the distance between both too")
    own.add_argument("--modes", type=int, metavar="K", help="with --labels: number of modes (default: as labelled)")


def _labelled(args: argparse.Namespace, label: str) -> Gate:
    from dualhead_eval.evaluation.label_table import label_gate, read_label_table

    return label_gate(read_label_table(args.labels), args.modes, label=label)


def _predicted(args: argparse.Namespace, label: str) -> Gate:
    import numpy as np

    from dualhead_eval.evaluation.prediction_columns import prediction_gate, read_predictions
    from dualhead_eval.partitions.opening import open_partition

    if args.partition is None:
        raise ValueError("--partition is missing: give FILE.json, endpoint:K or module:attribute")
    predictions = read_predictions(args.dataset, args.columns, samples=args.samples, horizon=args.horizon)
    partition = open_partition(args.partition, np.stack(predictions.paths))
    return prediction_gate(predictions, partition, taus=args.tau, metres=args.metres, label=label)


#: What makes the gate of each use, by the option that asks for it.
OWN_USES = {"labels": _labelled, "columns": _predicted}
