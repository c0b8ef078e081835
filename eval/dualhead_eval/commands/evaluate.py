"""``dualhead evaluate``: a policy, the exact reference, recorded predictions or a table of labels to a gate file."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dualhead_eval.commands.console import open_console, refuse_overwrite
from dualhead_eval.commands.own_task import OWN_USES, add_own_inputs, add_own_options
from dualhead_eval.commands.pictures import add_picture_options, show_films, show_preview
from dualhead_eval.commands.policy_draws import (
    add_draw_options,
    add_pair_input,
    deterministic_note,
    open_given_conditions,
    open_pair,
    open_sampler,
)
from dualhead_eval.commands.source_noise import add_source_noise_options

if TYPE_CHECKING:
    from dualhead_eval.evaluation.protocol import EvaluationProtocol
    from dualhead_eval.gate import Gate

#: Episodes rolled out where ``--episodes`` is not given.
EPISODES = 50
#: Options that serve only some of the uses, and which.
SERVES = {
    "dataset": ("policy", "pair", "exact", "record", "columns"),
    "pairs": ("policy", "pair", "exact"),
    "conditions": ("policy", "pair", "exact"),
    "nfe": ("policy", "pair", "exact"),
    "draws": ("policy", "pair"),
    "frame": ("policy", "pair"),
    "path_names": ("policy", "pair"),
    "source_noise_beta": ("policy", "exact", "record"),
    "source_noise_alignment": ("policy", "exact", "record"),
    "redraw_token": ("policy", "exact"),
    "token_draw": ("policy", "exact"),
    "update_card": ("policy",),
    "seed": ("policy", "pair", "exact", "record"),
    "episodes": ("record",),
    "samples": ("record", "columns"),
    "horizon": ("columns", "policy", "pair"),
    "partition": ("columns", "policy", "pair"),
    "metres": ("columns", "policy", "pair"),
    "modes": ("labels",),
    "tau": ("policy", "pair", "exact", "record", "rollouts", "columns"),
    "control": ("record",),
    "perturb": ("record",),
    "monitor": ("record",),
    "video": ("record", "rollouts"),
    "preview": ("policy", "exact"),
    "token": ("exact",),
    "token_replacement_prob": ("exact",),
    "consistency_weight": ("exact",),
}

DESCRIPTION = """\
Sample pairs of chunks under the test conditions of a dataset, label their modes and write the counts to a gate
file: both heads of a dual-head policy (or of the exact reference), two draws of any LeRobot policy, or one of each
of two policies; or count the predictions in recorded rollouts, in any LeRobotDataset, or anyone's labels.

  dualhead evaluate --policy outputs/ring --dataset data/ring/test --output ring.gate.json
  dualhead evaluate --policy outputs/A outputs/B --dataset data/ring/test --output gates/
  dualhead evaluate --policy outputs/act --dataset data/v2/test --output act.gate.json
  dualhead evaluate --pair outputs/A outputs/B --dataset data/v2/test --output pair.gate.json
  dualhead evaluate --exact --dataset data/ring/test --output exact.gate.json
  dualhead evaluate --exact --consistency-weight 3 --source-noise-beta 0 --dataset data/v2/test --output G.gate.json
  dualhead evaluate --policy outputs/ring --dataset data/ring/test --record data/rollouts --output loop.gate.json
  dualhead evaluate --rollouts data/rollouts --video films --output rollouts.gate.json
  dualhead evaluate --labels labels.csv --output mine.gate.json
  dualhead evaluate --columns prediction.a prediction.b --dataset D --partition side.json --output mine.gate.json

The defaults are the frozen protocol: 1280 pairs per condition, 20 Euler steps.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead evaluate``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    what = parser.add_argument_group("what to evaluate (one of)").add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--policy",
        action="extend",
        nargs="+",
        metavar="DIR",
        help="a checkpoint's folder, a training run's output folder, or OWNER/NAME on the hub; of several, a "
        "gate file each",
    )
    add_pair_input(what)
    what.add_argument(
        "--exact",
        action="store_true",
        help="the population-optimal sampler: the ring's or, with --consistency-weight, a robot's",
    )
    what.add_argument("--rollouts", metavar="DIR", help="a LeRobotDataset of recorded rollouts")
    add_own_inputs(what)
    parser.add_argument(
        "--dataset",
        metavar="DIR",
        help="split with the test conditions, e.g. data/ring/test; with --columns, any LeRobotDataset",
    )
    parser.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="gate file to write; of several policies, the folder of their gate files",
    )
    parser.add_argument("--label", help="name of the run in tables (default: the output file's name)")
    parser.add_argument("--pairs", type=int, help="sample pairs per condition (default: 1280)")
    parser.add_argument("--conditions", type=int, help="use the first N conditions (default: all)")
    parser.add_argument("--nfe", type=int, nargs="+", help="Euler steps, the reference first (default: 20)")
    parser.add_argument("--tau", type=float, nargs="+", default=[], help="further thresholds to count at")
    parser.add_argument("--seed", type=int, help="seed of the draws (default: 0)")
    parser.add_argument("--overwrite", action="store_true", help="replace the output file if it exists")
    parser.add_argument(
        "--update-card", action="store_true", help="with --policy: write the numbers into the policy's own card too"
    )
    add_draw_options(parser)
    add_own_options(parser)
    loop = parser.add_argument_group("closed loop, with --policy")
    loop.add_argument(
        "--record",
        type=Path,
        metavar="DIR",
        help="roll the policy out in the dataset's environment, record it as a LeRobotDataset in DIR, and count the "
        "predictions of every decision",
    )
    loop.add_argument("--episodes", type=int, help="episodes to roll out (default: 50)")
    loop.add_argument("--samples", type=int, help="pairs of chunks per decision (default: 2; --columns: 1)")
    loop.add_argument(
        "--control",
        choices=["joint", "position", "pose"],
        help="the head that drives; pose: position and orientation, for a policy with a rotation head (default: joint)",
    )
    loop.add_argument(
        "--perturb",
        metavar="KIND:SEVERITY",
        help="perturb the robot environment, e.g. joint_bias:0.06; joint_bias@2 is the second of its four levels",
    )
    add_picture_options(parser)
    loop.add_argument(
        "--monitor", type=Path, metavar="DIR", help="run a fitted failure monitor beside the episodes and record it too"
    )
    shared = parser.add_argument_group("what the heads share (default: as the policy was trained)")
    add_source_noise_options(shared)
    shared.add_argument("--redraw-token", action="store_true", help="give each head a token of its own")
    shared.add_argument(
        "--token-draw", choices=["uniform", "marginal", "learned"], help="how the heads' token is drawn"
    )
    exact = parser.add_argument_group("with --exact")
    exact.add_argument("--token", choices=["oracle"], help="condition both heads on the oracle token")
    exact.add_argument("--token-replacement-prob", type=float, metavar="P")
    exact.add_argument(
        "--consistency-weight",
        type=float,
        metavar="L",
        help="the optimum under endpoint consistency of this weight (two modes, ring or robot; trained with"
        " --source-noise-beta)",
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate and write the gate file.

    Raises:
        FileExistsError: If the output exists and ``--overwrite`` was not given.
        FileNotFoundError: If an input does not exist.
        ValueError: If an input or option is unusable.
    """
    several = len(args.policy or ()) > 1
    if several:
        _refuse_for_several(args)
    else:
        refuse_overwrite([args.output], overwrite=args.overwrite)
    if args.record is not None and not args.policy:
        raise ValueError("--record rolls out a policy: give --policy too")
    refuse_overwrite([args.video, args.preview], overwrite=args.overwrite)
    given = [name for name in (*OWN_USES, "rollouts", "record", "exact", "pair") if getattr(args, name)]
    use = given[0] if given else "policy"
    _refuse_unused(args, use)
    if args.dataset is None and use == "columns":
        raise ValueError("--dataset is missing: give the folder of the LeRobotDataset that holds the columns")
    if args.dataset is None and use not in ("rollouts", "labels"):
        raise ValueError("--dataset is missing: give the split with the test conditions, e.g. data/ring/test")

    if use not in OWN_USES:
        from dualhead_policy.quiet import quiet_libraries

        quiet_libraries()
    from dualhead_eval.gate import write_gate
    from dualhead_eval.report.content import make_report
    from dualhead_eval.report.effects_table import effects_table
    from dualhead_eval.report.terminal import render_table

    if several:
        gates = _policies(args)
    elif use in OWN_USES:
        gates = [OWN_USES[use](args, _label(args))]
        write_gate(gates[0], args.output, overwrite=args.overwrite)
    else:
        gates = [{"rollouts": _rollouts, "record": _rolled_out}.get(use, _sampled)(args)]

    console = open_console()
    console.print(render_table(effects_table(make_report(gates))))
    console.print(f"gate file{'s in' if several else ''}: {args.output}")
    return 0


def _refuse_for_several(args: argparse.Namespace) -> None:
    """Refuse what is for one policy."""
    for option in ("record", "label", "update_card", "preview"):
        if getattr(args, option):
            raise ValueError(
                f"--{option.replace('_', '-')} is for one policy, {len(args.policy)} are given: leave it out, or "
                "evaluate them one by one"
            )
    if args.output.exists() and not args.output.is_dir():
        raise FileExistsError(f"{args.output} is a file, expected a folder for several gate files: choose another")


def _refuse_unused(args: argparse.Namespace, use: str) -> None:
    """Refuse an option that the given use would pass over."""
    for option, uses in SERVES.items():
        value = getattr(args, option)
        # 0 is given, although it equals False.
        if not (value is None or value is False or value == []) and use not in uses:
            takers = " or ".join(f"--{name}" for name in uses)
            raise ValueError(
                f"--{option.replace('_', '-')} has no meaning with --{use}: leave it out, or give {takers} instead"
            )


def _given(args: argparse.Namespace, **fields: str) -> dict[str, Any]:
    """Arguments for ``fields`` (argument name -> option), those that the command was given."""
    values = {name: getattr(args, option) for name, option in fields.items()}
    return {name: value for name, value in values.items() if value is not None}


def _label(args: argparse.Namespace) -> str:
    return args.label or args.output.name.removesuffix(".json").removesuffix(".gate")


def _write(gate: Gate, args: argparse.Namespace) -> Gate:
    from dualhead_eval.gate import write_gate

    write_gate(gate, args.output, overwrite=args.overwrite)
    return gate


def _protocol(args: argparse.Namespace) -> EvaluationProtocol:
    from dualhead_eval.evaluation.protocol import EvaluationProtocol
    from dualhead_policy.sampling import SamplingCoupling

    return EvaluationProtocol(
        **_given(args, pairs="pairs", nfes="nfe", seed="seed"),
        taus=args.tau,
        coupling=SamplingCoupling(
            source_noise_beta=args.source_noise_beta,
            source_noise_alignment=args.source_noise_alignment,
            token_draw=args.token_draw,
            share_token=not args.redraw_token,
        ),
    )


def _policies(args: argparse.Namespace) -> list[Gate]:
    from tqdm import tqdm

    from dualhead_eval.evaluation.many_policies import evaluate_policies

    protocol, conditions = _protocol(args), open_given_conditions(args)
    total = len(args.policy) * len(conditions) * len(protocol.nfes)
    with tqdm(total=total, unit="condition", desc="sampling") as bar:
        gates = evaluate_policies(
            [(path, open_sampler(path, args)) for path in args.policy],
            conditions,
            protocol,
            args.output,
            own_steps=args.nfe is None,
            overwrite=args.overwrite,
            progress=bar.update,
        )
    return list(gates.values())


def _sampled(args: argparse.Namespace) -> Gate:
    from tqdm import tqdm

    from dualhead_eval.evaluation.open_loop import evaluate
    from dualhead_eval.evaluation.policy_card import update_card
    from dualhead_eval.evaluation.samplers import open_exact_reference, open_penalised_reference
    from dualhead_policy.pretrained import policy_folder

    protocol = _protocol(args)
    conditions = open_given_conditions(args)
    sampler: Any
    if args.consistency_weight is not None:
        if args.token is not None:
            raise ValueError("--consistency-weight has no reference with a token: leave --token out")
        beta = 1.0 if args.source_noise_beta is None else args.source_noise_beta
        sampler = open_penalised_reference(args.dataset, conditions, args.consistency_weight, beta)
    elif args.exact:
        options = _given(args, token="token", token_replacement_prob="token_replacement_prob")
        sampler = open_exact_reference(conditions, **options)
    else:
        sampler = open_pair(args) if args.pair else open_sampler(args.policy[0], args)
    if args.nfe is None:
        protocol = replace(protocol, nfes=(sampler.default_nfe,))
    show_preview(args, sampler, conditions, protocol)
    with tqdm(total=len(conditions) * len(protocol.nfes), unit="condition", desc="sampling") as bar:
        gate = evaluate(sampler, conditions, protocol, _label(args), progress=bar.update)
    _write(gate, args)
    if note := deterministic_note(sampler):
        print(note)
    if args.update_card:
        print(f"numbers written to {update_card(sampler, policy_folder(args.policy[0]), gate)}")
    return gate


def _rollouts(args: argparse.Namespace) -> Gate:
    from dualhead_eval.evaluation.rollouts import rollout_gate

    gate = _write(rollout_gate(args.rollouts, taus=args.tau, label=_label(args)), args)
    show_films(args)
    return gate


def _rolled_out(args: argparse.Namespace) -> Gate:
    from dualhead_eval.commands.roll_out import roll_out

    roll_out(args, EPISODES if args.episodes is None else args.episodes)
    args.rollouts = args.record
    return _rollouts(args)
