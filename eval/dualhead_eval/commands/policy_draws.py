"""The part of ``dualhead evaluate`` for draws of one policy, for two policies, and for LeRobot's other policies."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dualhead_eval.evaluation.conditions import ConditionBank
    from dualhead_eval.evaluation.decisions import Decider
    from dualhead_eval.evaluation.draws import PolicyDraws
    from dualhead_eval.evaluation.samplers import EvaluatedSampler
    from dualhead_policy.sampling import SamplingCoupling


def add_pair_input(what: argparse._ActionsContainer) -> None:
    """Define the pair of two policies."""
    what.add_argument(
        "--pair",
        nargs=2,
        metavar=("A", "B"),
        help="two policies, of which each draws one chunk of a pair: one gate file",
    )


def add_draw_options(parser: argparse.ArgumentParser) -> None:
    """Define what drawing takes."""
    drawn = parser.add_argument_group("draws, with --policy or --pair")
    drawn.add_argument(
        "--draws",
        choices=["position", "joint"],
        help="pair two independent draws of one head, whose paths are the position's or, through forward "
        "kinematics, the "
        "joint's (the default for LeRobot's other policies and for --pair: position)",
    )
    drawn.add_argument(
        "--frame", type=int, metavar="N", help="with --partition: the frame of every episode that is a condition (0)"
    )
    drawn.add_argument(
        "--path-names", nargs="+", metavar="NAME", help="with --partition: dimensions of the action that are the path"
    )


def open_sampler(path: str, args: argparse.Namespace) -> EvaluatedSampler | PolicyDraws:
    """Two heads of a dual-head policy, or draws of one head where they are asked for or the policy is of another type.

    Raises:
        FileNotFoundError: If there is no policy.
        ValueError: If it is damaged, of a type that is not opened, or options are for a dual-head policy's heads.
    """
    from dualhead_eval.evaluation.draws import PolicyDraws, open_paths
    from dualhead_eval.evaluation.samplers import open_policy
    from dualhead_policy.lerobot_policies.configuration_loading import read_policy_type
    from dualhead_policy.pretrained import policy_folder

    if args.draws is None and read_policy_type(policy_folder(path)) == "dualhead":
        return open_policy(path)
    for option in (
        "source_noise_beta",
        "source_noise_alignment",
        "token_draw",
        "redraw_token",
        "update_card",
        "preview",
    ):
        if _is_given(args, option):
            raise ValueError(
                f"--{option.replace('_', '-')} is about both heads of a dual-head policy, {path} is evaluated by "
                "independent draws: leave it out"
            )
    return PolicyDraws(open_paths(path, args.draws or "position"))


def open_decisions(
    path: str, samples: int, window: int, coupling: SamplingCoupling | None = None
) -> tuple[Decider, dict[str, Any]]:
    """What decides for a policy in closed loop, and what a recording says of it.

    Args:
        path: The policy.
        samples: Pairs of chunks per decision.
        window: Steps in which a mode is told.
        coupling: What the heads share; None: as they were trained.

    Raises:
        FileNotFoundError: If there is no policy.
        ValueError: If it is damaged, of a type that is not opened, or ``samples`` leaves no fresh pair, or it has no
            two heads to couple.
    """
    from dualhead_eval.evaluation.decisions import Decisions
    from dualhead_eval.evaluation.draw_decisions import DrawDecisions
    from dualhead_eval.evaluation.protocol import coupling_provenance
    from dualhead_policy.lerobot_policies.configuration_loading import read_policy_type
    from dualhead_policy.lerobot_policies.opening import open_lerobot_policy
    from dualhead_policy.pretrained import load_policy, policy_folder
    from dualhead_policy.training.provenance import lerobot_provenance, policy_provenance

    folder = policy_folder(path)
    if samples < 1:
        raise ValueError(f"--samples {samples} is not positive: give at least 1")
    if read_policy_type(folder) == "dualhead":
        policy, preprocess = load_policy(folder)
        provenance = policy_provenance(policy, folder) | coupling_provenance(coupling)
        return Decisions(policy, preprocess, samples, coupling), provenance
    if coupling is not None:
        raise ValueError(
            f"the source noise is about both heads of a dual-head policy, and {path} is of another type: leave "
            "--source-noise-beta and --source-noise-alignment out"
        )
    drawn = open_lerobot_policy(folder)
    return DrawDecisions(drawn, samples, window), lerobot_provenance(drawn.policy.config, folder)


def open_pair(args: argparse.Namespace) -> PolicyDraws:
    """One draw of each of two policies, called after their runs."""
    from dualhead_eval.evaluation.draws import PolicyDraws, open_paths
    from dualhead_eval.evaluation.many_policies import run_name

    first, second = (run_name(path) for path in args.pair)
    if first == second:
        first, second = f"{first} 1", f"{second} 2"
    sources = (open_paths(path, args.draws or "position") for path in args.pair)
    return PolicyDraws(*sources, names=(first, second), own_steps=args.nfe is None)


def open_given_conditions(args: argparse.Namespace) -> ConditionBank:
    """The branch points of a recorded split or, with ``--partition``, a frame of every episode of any dataset.

    Raises:
        FileNotFoundError, ValueError: See the two openers.
    """
    from dualhead_eval.evaluation.conditions import open_conditions

    if args.partition is None:
        for option in ("frame", "path_names", "horizon", "metres"):
            if _is_given(args, option):
                raise ValueError(
                    f"--{option.replace('_', '-')} goes with --partition: leave it out, or give a partition"
                )
        return open_conditions(args.dataset, args.conditions)
    from dualhead_eval.evaluation.frame_conditions import FrameConditions, open_frame_conditions
    from dualhead_eval.partitions.opening import open_partition

    if args.horizon is None:
        raise ValueError(
            "--horizon is missing: with --partition, say in how many steps from the condition a mode is told"
        )
    how = FrameConditions(args.horizon, args.frame or 0, tuple(args.path_names or ()), args.metres)
    return open_frame_conditions(
        args.dataset, how, lambda paths: open_partition(args.partition, paths), args.conditions
    )


def _is_given(args: argparse.Namespace, option: str) -> bool:
    value = getattr(args, option)
    return value is not None and value is not False  # 0 is given, although it equals False


def deterministic_note(sampler: EvaluatedSampler | PolicyDraws) -> str:
    """What to say of a policy whose draws are all the same; empty of any other."""
    if not getattr(sampler, "deterministic", False):
        return ""
    return (
        "deterministic: the policy predicts one chunk per condition whatever the seed, so that C = 0 by construction; "
        "its modes are those of its one prediction"
    )
