"""``dualhead monitor attach``: a policy's folder whose postprocessor raises a fitted monitor's alarms."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

DESCRIPTION = """\
Write a copy of a policy's folder whose postprocessor watches the two decodings of every executed action, so that
unmodified LeRobot raises alarms (log lines of lerobot-eval):

  dualhead monitor fit R/calibration --signals residual_executed --output M
  dualhead monitor attach M --policy P --output P-watched
  lerobot-eval --policy.path=P-watched --env.type=bimodal_bypass --env.control=joint
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead monitor attach``."""
    parser.description = DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("monitor", type=Path, metavar="MONITOR", help="a monitor fitted on residual_executed")
    parser.add_argument("--policy", type=Path, required=True, metavar="DIR", help="the policy to watch")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder of the watched policy")


def run(args: argparse.Namespace) -> int:
    """Write the watched policy's folder.

    Raises:
        FileExistsError: If the output holds anything.
        FileNotFoundError: If the monitor or the policy does not exist.
        ValueError: If the monitor is of another kind, or of another robot than the policy.
    """
    from dualhead_eval.commands.attached_policy import write_with_step
    from dualhead_eval.monitor.aggregation import EWMA_WEIGHT
    from dualhead_eval.monitor.monitor_file import load_monitor
    from dualhead_eval.monitor.signals.residual import ExecutedResidual
    from dualhead_eval.monitor.thresholds.conformal import SplitConformal
    from dualhead_policy.disagreement_step import REGISTRY_NAME
    from dualhead_policy.kinematics.robot_file import FILE_SCHEME
    from dualhead_policy.pretrained import load_policy, policy_folder
    from dualhead_policy.processor_loading import POSTPROCESSOR_FILE

    monitor, document = load_monitor(args.monitor)
    signal, threshold = monitor.channels[0].signal, monitor.channels[0].threshold
    fits = isinstance(signal, ExecutedResidual) and isinstance(threshold, SplitConformal)
    if not fits or monitor.aggregator_name != "ewma-max":
        raise ValueError(
            f"{args.monitor} reads {signal.name!r} by {monitor.aggregator_name} and {monitor.threshold_name}, expected "
            "residual_executed by ewma-max and a conformal threshold, which is all that a processor step can see: fit "
            "one with --signals residual_executed"
        )
    assert isinstance(signal, ExecutedResidual)
    assert isinstance(threshold, SplitConformal)
    if not math.isfinite(threshold.limit):
        raise ValueError(
            f"{args.monitor} has the limit {threshold.limit}, expected a number: calibrate on more episodes"
        )
    source = policy_folder(args.policy)
    policy, _ = load_policy(source)
    layout = policy.representation.kinematic_map
    if layout != document.layout or layout.startswith(FILE_SCHEME):
        raise ValueError(
            f"the policy's layout is {layout!r} and the monitor's {document.layout!r}, expected one built-in robot: "
            "give the policy whose rollouts calibrated the monitor"
        )
    if policy.config.n_action_steps != signal.steps:
        raise ValueError(
            f"the policy executes {policy.config.n_action_steps} steps of a chunk, the monitor reads {signal.steps}, "
            "expected the same number"
        )
    slices = policy.representation.slices
    step = {
        "registry_name": REGISTRY_NAME,
        "config": {
            "kinematic_map": layout,
            "joint": [slices["joint"].start, slices["joint"].stop],
            "position": [slices["position"].start, slices["position"].stop],
            "decision_steps": signal.steps,
            "weight": EWMA_WEIGHT,
            "limit_mm": threshold.limit,
        },
    }
    write_with_step(source, args.output, POSTPROCESSOR_FILE, step, place=1)
    print(f"policy: {args.output}, an alarm above {threshold.limit:.1f} mm ({threshold.guarantee})")
    return 0
