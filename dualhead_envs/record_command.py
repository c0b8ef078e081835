"""``dualhead record``: scripted demonstrations as LeRobotDatasets."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

DESCRIPTION = """\
Record scripted demonstrations as LeRobotDatasets ROOT/train, ROOT/val and ROOT/test, and a geometry card,
ROOT/card.json, for example

  dualhead record --root data/ring
  dualhead record --env RotatingRing-v4 --representation nullspace --preset full --root data/ring4
  dualhead record --env v2 --root data/v2
  dualhead record --env v2 --ways 3 --root data/v2_three_ways
  dualhead record --env v2 --obstacle none --amplitude 0.02 --root data/v2_20mm

An interrupted recording resumes when its command is repeated. Nothing is overwritten.
"""

_ALIASES = {"ring": "RotatingRing-v2", "v2": "BimodalBypass-v2", "v3": "RotatingBypass-v3"}
_PRESETS = {"smoke": 3_000, "full": 50_000}
#: Options that are keyword arguments of an environment, and all that only one family of environments has.
_RING_KWARGS = ("representation", "mode_probabilities", "mode_angles", "path_spread")
_RING = ("preset", "episodes", "conditions", "bank_seed", *_RING_KWARGS)
_BYPASS_KWARGS = ("ways", "obstacle", "amplitude")
_BYPASS = ("pairs", "workers", *_BYPASS_KWARGS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead record``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--env",
        default="ring",
        metavar="ID",
        help="RotatingRing-v2, -v3, -v4 or -v8 (ring: -v2), BimodalBypass-v2 (v2), RotatingBypass-v3 (v3); "
        "default: ring",
    )
    parser.add_argument("--root", type=Path, required=True, help="output folder; must not hold anything")
    parser.add_argument("--seed", type=int, default=0, help="seed of the demonstrations (default: 0)")
    parser.add_argument("--control", help="how the environment is driven: joint, position, pose")
    parser.add_argument("--tau", type=float, help="threshold of the mode partition (default: the environment's)")
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")

    ring = parser.add_argument_group("ring")
    ring.add_argument("--preset", choices=sorted(_PRESETS), help="paths in train: smoke 3,000 (default), full 50,000")
    ring.add_argument("--episodes", type=int, metavar="N", help="paths in train, instead of a preset")
    ring.add_argument("--conditions", type=int, metavar="N", help="conditions in val and in test (default: 75)")
    ring.add_argument("--bank-seed", type=int, metavar="N", help="seed of val and test (default: 0)")
    ring.add_argument("--representation", help="head A: orthogonal (default), polar, nullspace, or a family's")
    ring.add_argument(
        "--mode-probabilities", type=float, nargs="+", metavar="P", help="skewed prior over modes, sums to 1"
    )
    ring.add_argument(
        "--mode-angles",
        type=float,
        nargs="+",
        metavar="RAD",
        help="unequal spacing: the modes' offsets from theta",
    )
    ring.add_argument("--path-spread", type=float, metavar="M", help="sd of a path's offset (default: 0.08 m)")

    bypass = parser.add_argument_group("bypass")
    bypass.add_argument("--pairs", type=int, metavar="N", help="initial states, each shown in every mode")
    bypass.add_argument(
        "--ways", type=int, metavar="K", help="v2: 2 (left, right; default) or 3 (over the wall as well)"
    )
    bypass.add_argument("--obstacle", metavar="NAME", help="v2: wall (default) or none")
    bypass.add_argument(
        "--amplitude", type=float, metavar="M", help="v2 without a wall: how far aside the two ways go (0 to 0.2 m)"
    )
    bypass.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core)")
    bypass.add_argument(
        "--preview", type=Path, metavar="FILE", help="also show one initial state: contact sheet (.png) or film (.gif)"
    )


def run(args: argparse.Namespace) -> int:
    """Record and print what was recorded.

    Raises:
        ValueError: If an argument is wrong or belongs to another environment.
        FileExistsError: If the output folder holds anything, or is being written.
    """
    from dualhead_envs.record import record

    env_id = _ALIASES.get(args.env, args.env.removeprefix("dualhead_envs:"))
    is_ring = "Ring" in env_id
    own, foreign = (_RING, _BYPASS) if is_ring else (_BYPASS, _RING)
    if given := [f"--{name.replace('_', '-')}" for name in foreign if getattr(args, name) is not None]:
        raise ValueError(f"{', '.join(given)} is not an option of {env_id}: see `dualhead record --help`")
    if env_id != "BimodalBypass-v2" and (of_v2 := [n for n in _BYPASS_KWARGS if getattr(args, n) is not None]):
        raise ValueError(f"--{of_v2[0]} is not an option of {env_id}: see `dualhead record --help`")
    if args.preset and args.episodes is not None:
        raise ValueError("--preset and --episodes both set the size of train: give one of them")
    if args.preview is not None:
        if is_ring:
            raise ValueError(f"--preview is not an option of {env_id}: see `dualhead record --help`")
        if args.preview.exists():
            raise FileExistsError(f"{args.preview} already exists: choose another name, or delete it first")
        if args.preview.suffix not in (".png", ".gif"):
            raise ValueError(f"--preview {args.preview} should end in .png (contact sheet) or .gif (film)")
    options = {name: getattr(args, name) for name in own if getattr(args, name) is not None}
    if preset := options.pop("preset", None):
        options["episodes"] = _PRESETS[preset]
    env_kwargs = {name: options.pop(name) for name in (*_RING_KWARGS, *_BYPASS_KWARGS) if name in options}
    env_kwargs |= {name: getattr(args, name) for name in ("control", "tau") if getattr(args, name) is not None}

    start = time.monotonic()
    try:
        root = record(
            env_id, args.root, seed=args.seed, env_kwargs=env_kwargs, progress=not args.no_progress, **options
        )
    except (BlockingIOError, RuntimeError) as error:  # two recordings into one folder; too many rejections
        raise ValueError(error.args[0]) from error
    _print_summary(root, time.monotonic() - start)
    if args.preview is not None:
        from dualhead_envs.bypass.preview import write_preview

        modes = {name: env_kwargs[name] for name in _BYPASS_KWARGS if name in env_kwargs}
        print(write_preview(env_id, args.preview, seed=args.seed, **modes))
    return 0


def _print_summary(root: Path, seconds: float) -> None:
    """What was recorded: a line for each split, and the geometry card."""
    from rich.console import Console

    from dualhead_envs.recording.card_table import render_card
    from dualhead_envs.recording.geometry_card import read_geometry_card

    console = Console()
    console.print(f"Recorded {root} in {seconds:.1f} s", highlight=False, soft_wrap=True)
    for split in ("train", "val", "test"):
        info = json.loads((root / split / "meta" / "info.json").read_text())
        console.print(
            f"  {split:5} {info['total_episodes']:7,} episodes {info['total_frames']:9,} frames",
            highlight=False,
        )
    console.print(render_card(read_geometry_card(root / "card.json"), title="Geometry card (card.json)"))
