"""``dualhead demo``: the whole pipeline once, in minutes."""

from __future__ import annotations

import argparse
from pathlib import Path

from dualhead_eval.commands.console import open_console
from dualhead_eval.commands.counts import require_counts

DESCRIPTION = """\
Record demonstrations, train a handful of policies, evaluate them beside the exact reference, and print one table
and one figure that show what coordination between two heads is, and is not. An interrupted demo continues where
it stopped when the same command is given again.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead demo``."""
    parser.add_argument(
        "--env",
        choices=["v2", "v3", "ring"],
        default="v2",
        help="v2: a Panda passes a wall (default); v3: a beam; ring: the fast synthetic testbed",
    )
    parser.add_argument(
        "--preset",
        choices=["smoke", "full"],
        default="smoke",
        help="smoke: minutes (default); full: at most half an hour, the frozen protocol's 1280 pairs",
    )
    parser.add_argument("--output", type=Path, help="folder (default: outputs/demo-ENV-PRESET)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything (default: 0)")
    parser.add_argument("--jobs", type=int, default=2, help="policies trained at a time (default: 2)")


def run(args: argparse.Namespace) -> int:
    """Run the demo.

    Raises:
        FileExistsError: If the output folder holds something else.
    """
    require_counts(args, "jobs")
    from rich.console import Console

    Console(stderr=True).print("Starting: importing the libraries takes a few seconds.", style="dim")

    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    from dualhead_eval.report.content import make_report
    from dualhead_eval.report.figures.region import draw_region
    from dualhead_eval.studies.demo import PLANS
    from dualhead_eval.studies.demo_table import story_table
    from dualhead_eval.studies.stages import Demo, stage

    root = args.output or Path("outputs") / f"demo-{args.env}-{args.preset}"
    plan = PLANS[args.env]
    demo = Demo(plan, plan.budgets[args.preset], root, seed=args.seed, jobs=args.jobs)
    demo.claim_folder()
    budget = demo.budget
    with stage(demo.console, 1, 4, f"Record {plan.what_is_recorded.format(n=budget.demonstrations)}."):
        demo.record()
    with stage(
        demo.console,
        2,
        4,
        f"Train {len(demo.plan.policies)} policies, {budget.steps:,} steps of batch 128 each.",
    ):
        demo.train()
    with stage(
        demo.console,
        3,
        4,
        f"Sample {budget.pairs} pairs under each of the test conditions, 20 Euler steps, and count modes.",
    ):
        results = demo.evaluate()
    with stage(demo.console, 4, 4, "Draw the attainable region."):
        figure = root / "region.png"
        draw_region(make_report([trained for _, trained, _ in results]), figure)

    console = open_console()
    console.print(story_table(results))
    console.print(f"figure:     {figure}")
    console.print(f"gate files: {root / 'gates'}   (dualhead report {root / 'gates'}/*.gate.json)")
    console.print(f"policies:   {root / 'policies'}   (LeRobot checkpoints)")
    return 0
