"""``dualhead certify``: a policy's folder that comes to a coordination verdict in unmodified LeRobot."""

from __future__ import annotations

import argparse
from pathlib import Path

DESCRIPTION = """\
Write a copy of a dual-head policy's folder whose preprocessor draws pairs of both heads at every decision and counts
the modes that they choose, so that unmodified LeRobot logs what the coordination certificate says:

  dualhead certify --policy P --dataset data/v2/test --output P-certified
  lerobot-eval --policy.path=P-certified --env.type=bimodal_bypass --env.control=joint --eval.n_episodes=50

  INFO ... coordination certificate: N decisions, valid ..., rho ... [..., ...]: VERDICT

What the policy executes stays the same. Modes are those of the environment that the dataset was recorded from, or of a
partition that needs no code (--partition).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead certify``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--policy", type=Path, required=True, metavar="DIR", help="the dual-head policy to certify")
    modes = parser.add_mutually_exclusive_group(required=True)
    modes.add_argument(
        "--dataset", type=Path, metavar="DIR", help="recorded split whose environment says what a mode is"
    )
    modes.add_argument("--partition", type=Path, metavar="FILE", help="JSON description of a partition instead")
    parser.add_argument("--draws", type=int, default=8, help="pairs per decision, 2 or more (default: 8)")
    parser.add_argument("--alpha", type=float, default=0.05, help="probability that any bound ever fails (0.05)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the pairs' draws (default: 0)")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder of the certified policy")


def run(args: argparse.Namespace) -> int:
    """Write the certified policy's folder.

    Raises:
        FileExistsError: If the output holds anything.
        FileNotFoundError: If the policy, the dataset or the partition does not exist.
        ValueError: If one of them is none, or an option is out of range.
    """
    from dualhead_envs.dataset_frames import read_split
    from dualhead_eval.commands.attached_policy import write_with_step
    from dualhead_eval.evaluation.conditions import recorded_environment
    from dualhead_eval.partitions.partition_file import read_partition
    from dualhead_policy.pretrained import load_policy, policy_folder
    from dualhead_policy.processor_loading import CERTIFICATE_NAME, PREPROCESSOR_FILE

    if args.draws < 2 or not 0 < args.alpha < 1 or args.seed < 0:
        raise ValueError(
            f"--draws {args.draws} --alpha {args.alpha} --seed {args.seed}, expected 2 pairs or more, a probability "
            "between 0 and 1 and a seed of at least 0"
        )
    source = policy_folder(args.policy)
    load_policy(source)
    if args.partition is not None:
        modes = {"partition": read_partition(args.partition).to_dict()}
    else:
        env_id, env_kwargs = recorded_environment(read_split(args.dataset))
        modes = {"environment": {"env_id": env_id, "env_kwargs": env_kwargs}}
    config = modes | {"draws": args.draws, "alpha": args.alpha, "seed": args.seed}
    write_with_step(
        source, args.output, PREPROCESSOR_FILE, {"registry_name": CERTIFICATE_NAME, "config": config}, place=3
    )
    print(f"policy: {args.output}, {args.draws} pairs per decision, bounds at {1 - args.alpha:.0%}")
    return 0
