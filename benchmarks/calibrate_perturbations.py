"""Which severities of a perturbation make a policy fail in 20, 35, 50 and 60 % of its episodes.

    uv run python benchmarks/calibrate_perturbations.py --policy outputs/K --env v2 --output calibration.json

Every kind is bisected: a cell (kind, severity) is as many new episodes as ``--episodes`` says, no seed is used twice,
and a target is met when a cell's share of failures is within ``--tolerance`` of it. All episodes of a cell run in
lock-step, so that the policy samples them as one batch. The output holds every cell with its failures by kind, and is
continued when the command is repeated; the levels that it proposes go to
``dualhead_envs/bypass/perturbations/levels.py`` by hand.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy loads its libraries

import gymnasium as gym
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.bypass.environment import MAX_EPISODE_STEPS
from dualhead_envs.bypass.outcome import FAILURES
from dualhead_envs.bypass.perturbations.levels import LEVELS
from dualhead_envs.bypass.perturbations.perturbation import KINDS
from dualhead_policy.pretrained import load_policy
from dualhead_policy.quiet import quiet_libraries

IDS = {"v2": "BimodalBypass-v2", "v3": "RotatingBypass-v3"}
TARGETS = (0.20, 0.35, 0.50, 0.60)
NOMINAL = "nominal"
#: Kinds of which a smaller severity is the harder.
DESCENDING = ("friction",)
OBSERVATIONS = {"agent_pos": "observation.state", "environment_state": "observation.environment_state"}


@dataclass(frozen=True)
class Cell:
    """Episodes of one kind and severity: how many, their first seed, and how they ended."""

    kind: str
    severity: float
    episodes: int
    first_seed: int
    ends: dict[str, int]

    @property
    def failed(self) -> float:
        """Share of the episodes that failed, in any way."""
        return 1.0 - self.ends.get("none", 0) / self.episodes


def roll_out(policy: Any, preprocess: Any, env_id: str, perturbation: str | None, seeds: range) -> dict[str, int]:
    """How the episodes of ``seeds`` end under the joint head, by :data:`FAILURES`."""
    envs = [gym.make(f"dualhead_envs:{env_id}", perturbation=perturbation).unwrapped for _ in seeds]
    executed = envs[0].layout.control_indices("joint")  # type: ignore[attr-defined]
    observations = [env.reset(seed=seed)[0] for env, seed in zip(envs, seeds, strict=True)]
    ends = ["none"] * len(envs)
    running = set(range(len(envs)))
    torch.manual_seed(seeds[0])
    policy.reset()
    for _ in range(MAX_EPISODE_STEPS):
        batch = {
            name: torch.from_numpy(np.stack([observation[key] for observation in observations]))
            for key, name in OBSERVATIONS.items()
        }
        with torch.no_grad():
            actions = policy.select_action(preprocess(batch)).cpu().numpy()
        for i in sorted(running):
            observations[i], _, terminated, _, info = envs[i].step(actions[i, executed])
            ends[i] = info["failure"]
            if terminated:
                running.remove(i)
        if not running:
            break
    return dict(Counter(ends))


class Calibration:
    """The cells measured so far, and the search for the next; every cell is written to ``output`` at once."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.args, self.env_id = args, IDS[args.env]
        self.policy, self.preprocess = load_policy(args.policy)
        self.cells: list[Cell] = []
        if args.output.exists():
            self.cells = [Cell(**cell) for cell in json.loads(args.output.read_text())["cells"]]

    def measure(self, kind: str, severity: float) -> Cell:
        """The cell of ``kind`` and ``severity``, from its new episodes if it has not been measured."""
        for cell in self.cells:
            if (cell.kind, cell.severity) == (kind, severity):
                return cell
        first = max((cell.first_seed + cell.episodes for cell in self.cells), default=self.args.first_seed)
        seeds = range(first, first + self.args.episodes)
        perturbation = None if kind == NOMINAL else f"{kind}:{severity}"
        ends = roll_out(self.policy, self.preprocess, self.env_id, perturbation, seeds)
        self.cells.append(Cell(kind, severity, len(seeds), first, ends))
        content = {
            "env_id": self.env_id, "policy": self.args.policy, "control": "joint",
            "cells": [asdict(cell) for cell in self.cells],
        }  # fmt: skip
        write_atomically(self.args.output, json.dumps(content, indent=1) + "\n")
        return self.cells[-1]

    def bracket(self, kind: str) -> None:
        """Measure severities outward from the present levels until they enclose all targets, or the kind ends."""
        about = KINDS[kind]
        levels = LEVELS[self.env_id][kind]
        for start, target, harder in ((levels[0], TARGETS[0], False), (levels[-1], TARGETS[-1], True)):
            severity = float(start)
            for _ in range(self.args.cells):
                failed = self.measure(kind, severity).failed
                if (failed >= target) if harder else (failed <= target):
                    break
                larger = harder != (kind in DESCENDING)
                factor = 1.6 if larger else 1 / 1.6
                following = severity * factor
                if about.whole:
                    following = max(1.0, math.ceil(following) if larger else math.floor(following))
                following = float(f"{min(max(following, about.least), about.most):.3g}")
                if following == severity:
                    break
                severity = following

    def level(self, kind: str, target: float) -> Cell:
        """The cell nearest ``target``, after bisecting between the severities that enclose it."""
        sign = -1.0 if kind in DESCENDING else 1.0
        for _ in range(self.args.cells):
            cells = sorted((c for c in self.cells if c.kind == kind), key=lambda c: sign * c.severity)
            nearest = min(cells, key=lambda c: abs(c.failed - target))
            if abs(nearest.failed - target) <= self.args.tolerance:
                return nearest
            below = [c for c in cells if c.failed < target]
            above = [c for c in cells if c.failed > target]
            if not below or not above:
                return nearest
            low, high = max(below, key=lambda c: sign * c.severity), min(above, key=lambda c: sign * c.severity)
            middle = math.sqrt(low.severity * high.severity)
            middle = float(round(middle)) if KINDS[kind].whole else float(f"{middle:.3g}")
            if any(c.severity == middle for c in cells):
                return nearest
            self.measure(kind, middle)
        return min((c for c in self.cells if c.kind == kind), key=lambda c: abs(c.failed - target))


def main() -> None:
    """Calibrate the kinds asked for and print every cell and the proposed levels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", required=True, metavar="DIR")
    parser.add_argument("--env", required=True, choices=sorted(IDS))
    parser.add_argument("--output", required=True, type=Path, metavar="FILE")
    parser.add_argument("--kinds", nargs="+", choices=sorted(KINDS), default=list(KINDS))
    parser.add_argument("--episodes", type=int, default=80, help="episodes of a cell (default: 80)")
    parser.add_argument("--tolerance", type=float, default=0.07, help="of a share of failures (default: 0.07)")
    parser.add_argument("--cells", type=int, default=6, help="most new severities in a search (default: 6)")
    parser.add_argument("--first-seed", type=int, default=1_000_000, help="seed of the first episode")
    args = parser.parse_args()
    quiet_libraries()
    calibration = Calibration(args)
    calibration.measure(NOMINAL, 0.0)
    proposed = {}
    for kind in tqdm(args.kinds, unit="kind"):
        calibration.bracket(kind)
        proposed[kind] = [calibration.level(kind, target) for target in TARGETS]

    table = Table(title=f"{calibration.env_id}, {args.policy}")
    for heading in ("kind", "severity", "episodes", "failed", *FAILURES[1:]):
        table.add_column(heading)
    for cell in sorted(calibration.cells, key=lambda c: (c.kind, c.severity)):
        shares = [f"{cell.ends.get(failure, 0) / cell.episodes:.2f}" for failure in FAILURES[1:]]
        table.add_row(cell.kind, f"{cell.severity:g}", str(cell.episodes), f"{cell.failed:.2f}", *shares)
    console = Console(width=120)
    console.print(table)
    for kind, cells in proposed.items():
        levels = ", ".join(f"{cell.severity:g} ({cell.failed:.0%})" for cell in cells)
        console.print(f"{kind}: {levels}")


if __name__ == "__main__":
    main()
