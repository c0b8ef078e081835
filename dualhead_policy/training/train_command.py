"""``dualhead train``: the flags of ``lerobot-train``, many times faster."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

DESCRIPTION = """\
Train a dual-head policy with the loss, optimiser, data order and checkpoints of lerobot-train, the training
windows held in memory. Takes the flags of lerobot-train, for example

  dualhead train --dataset.root=data/ring/train --output_dir=outputs/ring --policy.token=oracle
  dualhead train --dataset.root=data/ring/train --output_dir=outputs/ring --seeds 0 1 2
  dualhead train --resume=true --output_dir=outputs/ring

Every field of DualheadConfig can be set as --policy.FIELD=VALUE (docs/policy.md lists them).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags that lerobot-train does not have."""
    parser.description = DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--preset",
        choices=["smoke", "full", "paper"],
        help="training budget that other flags override (default: smoke, 3,000 steps)",
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", metavar="S", help="train one run a seed, into OUTPUT_DIR/seed-S"
    )
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time, with --seeds (default: 2)")
    parser.add_argument(
        "--fresh_paths",
        action="store_true",
        help="ring only: draw new paths from the generator at every step instead of the recorded ones",
    )
    parser.set_defaults(takes_remaining=True)


def run(args: argparse.Namespace, remaining: list[str]) -> int:
    """Train and say where the policy is."""
    from lerobot.configs import parser as lerobot_parser

    from dualhead_policy.training.parallel import Run, train_runs

    if not args.seeds:
        saved = _train_here(args, remaining)
        print(f"policy: {saved}")
        return 0
    output = lerobot_parser.parse_arg("output_dir", remaining)
    if output is None:
        raise ValueError("--seeds needs a place for its runs: give --output_dir")
    others = lerobot_parser.filter_arg("output_dir", lerobot_parser.filter_arg("seed", remaining))
    runs = [
        Run(
            f"seed {seed}",
            [*others, f"--seed={seed}", f"--output_dir={output}/seed-{seed}"],
            args.preset,
            args.fresh_paths,
        )
        for seed in args.seeds
    ]
    for name, path in train_runs(runs, jobs=args.jobs).items():
        print(f"{name}: {path}")
    return 0


def _train_here(args: argparse.Namespace, remaining: list[str]) -> Path:
    import contextlib

    from tqdm import tqdm

    from dualhead_policy.quiet import quiet_libraries
    from dualhead_policy.training.run import train_run
    from dualhead_policy.training.trainer import Progress, Training

    @contextlib.contextmanager
    def follow(training: Training) -> Iterator[Progress]:
        with tqdm(total=training.cfg.steps, initial=training.step, unit="step", desc="training") as bar:

            def progress(step: int, loss: float) -> None:
                bar.update(1)
                if step % 100 == 0:
                    bar.set_postfix(loss=f"{loss:.3f}", refresh=False)

            yield progress

    quiet_libraries()
    # LeRobot announces on standard output what it loads.
    with contextlib.redirect_stdout(None):
        return train_run(remaining, args.preset, fresh_paths=args.fresh_paths, follow=follow)
