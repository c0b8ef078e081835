"""Runs of one mechanism together: its seeds, and the checkpoints of every training."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from dualhead_eval.statistics.family_summary import family_key
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.training_record import policy_provenance_of

#: What a label says of its checkpoint, and what a report adds where labels collide.
_CHECKPOINT, _COLLISION = re.compile(r", \d+ steps$"), re.compile(r" #\d+$")


@dataclass(frozen=True)
class RunGroup:
    """Runs of one mechanism, network and data.

    Attributes:
        label: What they have in common.
        runs: Its runs, by seed and then by training steps.
    """

    label: str
    runs: tuple[Run, ...]

    @property
    def last(self) -> tuple[Run, ...]:
        """The runs with the most training steps: one per seed."""
        most = max(run.training.steps or 0 for run in self.runs)
        return tuple(run for run in self.runs if (run.training.steps or 0) == most)

    @property
    def trainings(self) -> list[tuple[Run, ...]]:
        """The checkpoints of every training that has several here, by steps."""
        found: dict[tuple[int | None, object], list[Run]] = {}
        for run in self.runs:
            found.setdefault((run.training.seed, _budget(run)), []).append(run)
        return [tuple(runs) for runs in found.values() if len(runs) > 1]

    def member(self, run: Run) -> str:
        """What tells ``run`` from the others of its group."""
        known = []
        if run.training.seed is not None:
            known.append(f"seed {run.training.seed}")
        if run.training.steps is not None:
            known.append(f"{run.training.steps:,} steps")
        return ", ".join(known) or run.name


def group_runs(runs: Iterable[Run]) -> list[RunGroup]:
    """Groups in the order of their first run. A run whose seed and steps are unknown is a group of its own."""
    members: dict[object, list[Run]] = {}
    for run in runs:
        known = run.training.seed is not None and not run.training.reference
        members.setdefault(_key(run) if known else id(run), []).append(run)
    groups = list(members.values())
    names = _distinct([_without_checkpoint(group[0]) for group in groups], groups)
    return [
        RunGroup(name, tuple(sorted(group, key=lambda run: (run.training.seed or 0, run.training.steps or 0))))
        for name, group in zip(names, groups, strict=True)
    ]


def _key(run: Run) -> str:
    """The identity of the run's family without the steps of the checkpoint and the run's budget."""
    heads, n_modes, provenance, policy = json.loads(family_key(run.gate))
    policy.pop("training_step", None)
    provenance.pop("training_step", None)
    if isinstance(policy.get("training"), dict):
        policy["training"].pop("steps", None)
    return json.dumps([heads, n_modes, provenance, policy], sort_keys=True)


def _budget(run: Run) -> object:
    training = policy_provenance_of(run.gate).get("training")
    return training.get("steps") if isinstance(training, dict) else None


def _distinct(names: list[str], groups: list[list[Run]]) -> list[str]:
    """Names that differ: with what their networks differ in, with a number where that is not enough."""
    names = [_without_seed(name, group) for name, group in zip(names, groups, strict=True)]
    networks: dict[str, list[set[str]]] = {}
    for name, group in zip(names, groups, strict=True):
        networks.setdefault(name, []).append(set(group[0].training.network_name.split(", ")))
    names = [
        _with_network(name, group[0].training.network_name, networks[name])
        for name, group in zip(names, groups, strict=True)
    ]
    repeated, seen = Counter(names), Counter[str]()
    distinct = []
    for name in names:
        seen[name] += 1
        distinct.append(f"{name} #{seen[name]}" if repeated[name] > 1 else name)
    return distinct


def _without_checkpoint(run: Run) -> str:
    name = run.name if _COLLISION.search(run.label) else _COLLISION.sub("", run.name)
    return _CHECKPOINT.sub("", name)


def _with_network(name: str, network: str, others: list[set[str]]) -> str:
    parts = [part for part in network.split(", ") if part not in set.intersection(*others)]
    return f"{name} ({', '.join(parts)})" if parts else name


def _without_seed(name: str, group: list[Run]) -> str:
    """The name of a group of several runs without its first run's seed."""
    seed = group[0].training.seed
    return name if len(group) == 1 else re.sub(rf"[ ,/_-]*(\(?seed[ _-]?)?\b{seed}\)?$", "", name) or name
