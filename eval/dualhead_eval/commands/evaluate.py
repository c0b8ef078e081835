"""``dualhead evaluate``: a policy, the exact reference or recorded rollouts to a gate file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dualhead_eval.commands.console import open_console, refuse_overwrite

if TYPE_CHECKING:
    from dualhead_eval.gate.gate import Gate

DESCRIPTION = """\
Sample both heads of a policy (or of the exact reference) under the test conditions of a dataset, label their
modes and write the counts to a gate file; or count the predictions in recorded rollouts.

  dualhead evaluate --policy outputs/ring --dataset data/ring/test --output ring.gate.json
  dualhead evaluate --exact --dataset data/ring/test --output exact.gate.json
  dualhead evaluate --policy outputs/ring --dataset data/ring/test --record data/rollouts --output loop.gate.json
  dualhead evaluate --rollouts data/rollouts --output rollouts.gate.json

The defaults are the frozen protocol: 1280 pairs a condition, 20 Euler steps.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead evaluate``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    what = parser.add_argument_group("what to evaluate (one of)").add_mutually_exclusive_group(required=True)
    what.add_argument("--policy", metavar="DIR", help="a checkpoint's folder, or a training run's output folder")
    what.add_argument("--exact", action="store_true", help="the ring's population-optimal sampler")
    what.add_argument("--rollouts", metavar="DIR", help="a LeRobotDataset of recorded rollouts")
    parser.add_argument("--dataset", metavar="DIR", help="split with the test conditions, e.g. data/ring/test")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="gate file to write")
    parser.add_argument("--label", help="name of the run in tables (default: the output file's name)")
    parser.add_argument("--pairs", type=int, default=1280, help="sample pairs a condition (default: 1280)")
    parser.add_argument("--conditions", type=int, help="use the first N conditions (default: all)")
    parser.add_argument("--nfe", type=int, nargs="+", default=[20], help="Euler steps, the reference first")
    parser.add_argument("--tau", type=float, nargs="+", default=[], help="further thresholds to count at")
    parser.add_argument("--seed", type=int, default=0, help="seed of the draws (default: 0)")
    parser.add_argument("--overwrite", action="store_true", help="replace the output file if it exists")
    parser.add_argument(
        "--update-card", action="store_true", help="with --policy: write the numbers into the policy's own card too"
    )
    loop = parser.add_argument_group("closed loop, with --policy")
    loop.add_argument(
        "--record",
        type=Path,
        metavar="DIR",
        help="roll the policy out in the dataset's environment,"
        " record it as a LeRobotDataset in DIR, and count the predictions of every decision",
    )
    loop.add_argument("--episodes", type=int, default=50, help="episodes to roll out (default: 50)")
    loop.add_argument("--samples", type=int, default=2, help="chunks per head and decision (default: 2)")
    loop.add_argument("--control", choices=["joint", "position"], default="joint", help="the head that drives")
    shared = parser.add_argument_group("what the heads share (default: as the policy was trained)")
    shared.add_argument("--source-noise-beta", type=float, metavar="B", help="1 private noise, 0 shared noise")
    shared.add_argument("--redraw-token", action="store_true", help="give each head a token of its own")
    exact = parser.add_argument_group("with --exact")
    exact.add_argument("--token", choices=["oracle"], help="condition both heads on the oracle token")
    exact.add_argument("--token-replacement-prob", type=float, default=0.0, metavar="P")


def run(args: argparse.Namespace) -> int:
    """Evaluate and write the gate file.

    Raises:
        FileExistsError: If the output exists and ``--overwrite`` was not given.
        FileNotFoundError: If an input does not exist.
        ValueError: If an input or option is unusable.
    """
    refuse_overwrite([args.output], overwrite=args.overwrite)
    for name, value in [("--pairs", args.pairs), *(("--nfe", n) for n in args.nfe)]:
        if value < 1:
            raise ValueError(f"{name} {value} is not positive: give at least 1")
    if args.source_noise_beta is not None and not 0 <= args.source_noise_beta <= 1:
        raise ValueError(f"--source-noise-beta {args.source_noise_beta} is outside [0, 1]: give a value inside")

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    from dualhead_eval.gate.file import write_gate
    from dualhead_eval.report.content import make_report
    from dualhead_eval.report.tables import effects_table
    from dualhead_eval.report.terminal import render_table

    if args.update_card and (not args.policy or args.record is not None):
        raise ValueError("--update-card writes sampled numbers into a policy's card: give --policy without --record")
    if args.record is not None and not args.policy:
        raise ValueError("--record rolls out a policy: give --policy too")
    gate = _rollouts(args) if args.rollouts else _rolled_out(args) if args.record else _sampled(args)
    write_gate(gate, args.output, overwrite=args.overwrite)
    if args.update_card:
        from dualhead_eval.evaluation.policy_card import write_card_numbers

        print(f"numbers written to {write_card_numbers(args.policy, gate)}")

    console = open_console()
    console.print(render_table(effects_table(make_report([gate]))))
    console.print(f"gate file: {args.output}")
    return 0


def _label(args: argparse.Namespace) -> str:
    return args.label or args.output.name.removesuffix(".json").removesuffix(".gate")


def _sampled(args: argparse.Namespace) -> Gate:
    from tqdm import tqdm

    from dualhead_eval.evaluation.open_loop import EvaluationProtocol
    from dualhead_eval.evaluation.samplers import (
        evaluate_source,
        open_conditions,
        open_exact_reference,
        open_policy,
    )
    from dualhead_policy.sampling import SamplingCoupling

    if args.dataset is None:
        raise ValueError("--dataset is missing: give the split with the test conditions, e.g. data/ring/test")
    bank = open_conditions(args.dataset, args.conditions)
    if args.exact:
        source = open_exact_reference(bank, token=args.token, token_replacement_prob=args.token_replacement_prob)
    else:
        source = open_policy(args.policy)
    protocol = EvaluationProtocol(
        pairs=args.pairs,
        nfes=args.nfe,
        taus=args.tau,
        seed=args.seed,
        coupling=SamplingCoupling(source_noise_beta=args.source_noise_beta, share_token=not args.redraw_token),
    )
    with tqdm(total=len(bank.pair_ids) * len(args.nfe), unit="condition", desc="sampling") as bar:
        return evaluate_source(source, bank, protocol, label=_label(args), progress=bar.update)


def _rollouts(args: argparse.Namespace) -> Gate:
    from dualhead_eval.evaluation.closed_loop import rollout_gate

    return rollout_gate(args.rollouts, taus=args.tau, label=_label(args))


def _rolled_out(args: argparse.Namespace) -> Gate:
    from tqdm import tqdm

    from dualhead_envs.dataset_frames import read_split
    from dualhead_eval.evaluation.closed_loop import record_rollouts, rollout_gate
    from dualhead_eval.evaluation.samplers import policy_provenance
    from dualhead_policy.pretrained import load_policy, policy_folder

    if args.dataset is None:
        raise ValueError("--dataset is missing: its environment is where the policy is rolled out")
    sidecar = read_split(args.dataset).sidecar
    policy, preprocess = load_policy(args.policy)
    with tqdm(total=args.episodes, unit="episode", desc="rolling out") as bar:
        loop, verdict = record_rollouts(
            policy,
            preprocess,
            args.record,
            env_id=sidecar["env_id"],
            env_kwargs={**sidecar["env_kwargs"], "control": args.control},
            episodes=args.episodes,
            samples=args.samples,
            seed=args.seed,
            provenance=policy_provenance(policy, policy_folder(args.policy)),
            progress=bar.update,
        )
    print(f"closed loop, {loop}; recorded in {args.record}\nruntime certificate after these episodes: {verdict}")
    return rollout_gate(args.record, taus=args.tau, label=_label(args))
