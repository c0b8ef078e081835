"""Families: the seeds of one mechanism found among runs, and their summary with the seed as the unit.

A seed is a training seed and the checkpoint that it led to. A second evaluation of one checkpoint, or a copy of its
gate file, is no second seed and is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np

from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.gate import Gate
from dualhead_eval.gate.file import gate_digest
from dualhead_eval.statistics.bootstrap import Equivalence
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.run_summary import RunSummary
from dualhead_eval.statistics.seeds import seed_equivalence, seed_t_interval
from dualhead_eval.statistics.training_record import policy_provenance_of, settled

#: Provenance that may differ between the seeds of one family, and what follows from the seed.
_PER_SEED = {"label", "seed", "seeds", "path", "run", "merged_from", "checkpoint", "token_nmi"}
#: What a family's identity takes of the training run; the rest (losses) follows from the seed.
_TRAINING = ("batch_size", "steps", "fresh_paths")
#: What it takes of recorded rollouts; the episodes and their outcomes are what was measured.
_ROLLOUTS = ("env_id", "env_kwargs", "horizon", "samples", "num_inference_steps", "partition")
FAMILY_STATISTICS = (
    "valid_rate",
    "obs",
    "bl",
    "delta",
    "capacity",
    "capacity_tight",
    "rho",
    "delta_pooled",
    "simpson",
)


@dataclass(frozen=True)
class FamilySummary:
    """Mean over the seeds of one mechanism, the seed being the unit.

    Attributes:
        label: Name of the family.
        runs: The seeds' summaries.
        mean: Mean over seeds of every numeric statistic, by name; rho is the mean of the seeds' ratios over
            the seeds that define it.
        sd: Between-seed standard deviation (n - 1), NaN for a single seed.
        rho_ratio_of_means: The other convention: mean delta over mean capacity.
        rho_interval: 95% t interval of the mean rho over seeds, None with fewer than two that define it.
        equivalence: Seed-level TOST of rho at 2%, None with fewer than two seeds that define it.
        occupancy: Site of the mean point.
        seeds: Training seeds, in the order of the runs.
        loss: How many of the seeds had a settled loss.
    """

    label: str
    runs: tuple[RunSummary, ...]
    mean: dict[str, float]
    sd: dict[str, float]
    rho_ratio_of_means: float
    rho_interval: Interval | None
    equivalence: Equivalence | None
    occupancy: Occupancy
    seeds: tuple[int, ...] = ()
    loss: str = "unknown"


def summarise_family(
    label: str, runs: Sequence[RunSummary], *, seeds: Sequence[int] = (), loss: str = "unknown"
) -> FamilySummary:
    """Family mean over seeds.

    Args:
        label: Name of the family.
        runs: Summaries of its seeds.
        seeds: Their training seeds.
        loss: How many had a settled loss.

    Raises:
        ValueError: If no run is given or runs differ in K, threshold or integration steps.
    """
    points = {(run.n_modes, run.tau, run.nfe) for run in runs}
    if len(points) != 1:
        raise ValueError(
            f"family {label!r} holds runs at (K, tau, NFE) {sorted(points)}, expected one operating point: "
            "summarise every run at the same tau and NFE"
        )
    columns = {name: np.array([getattr(run, name) for run in runs]) for name in FAMILY_STATISTICS}
    columns = {name: column[np.isfinite(column)] for name, column in columns.items()}
    nan, rho = float("nan"), columns["rho"]
    mean = {name: float(column.mean()) if column.size else nan for name, column in columns.items()}
    return FamilySummary(
        label=label,
        runs=tuple(runs),
        mean=mean,
        sd={name: float(column.std(ddof=1)) if column.size > 1 else nan for name, column in columns.items()},
        rho_ratio_of_means=mean["delta"] / mean["capacity"] if mean["capacity"] > 0 else nan,
        rho_interval=seed_t_interval(rho) if rho.size > 1 else None,
        equivalence=seed_equivalence(rho) if rho.size > 1 else None,
        occupancy=occupancy(mean["rho"], mean["capacity"], runs[0].n_modes),
        seeds=tuple(seeds),
        loss=loss,
    )


def family_key(gate: Gate) -> str:
    """What two gates must share to be seeds of one mechanism: everything but the seed and what follows from it.

    Configuration and network, training budget, batch size, recorded or fresh paths, conditions, protocol.
    """
    provenance = _without_seed(gate.provenance)
    policy = _without_seed(policy_provenance_of(gate))
    training = policy.pop("training", None)
    if isinstance(training, Mapping):
        policy["training"] = {name: training.get(name) for name in _TRAINING}
    if isinstance(policy.get("config"), Mapping):
        policy["config"] = _without_seed(policy["config"])
    rollouts = provenance.pop("rollouts", None)
    if isinstance(rollouts, Mapping):
        provenance["rollouts"] = {name: rollouts.get(name) for name in _ROLLOUTS}
    provenance = {key: value for key, value in provenance.items() if key not in ("training", "config")}
    return json.dumps([gate.heads, gate.n_modes, provenance, policy], sort_keys=True, default=str)


def _without_seed(content: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in content.items() if key not in _PER_SEED}


def find_families(runs: Iterable[Run]) -> list[FamilySummary]:
    """Families with two or more seeds, first pair of heads, in the order of their first run.

    Ring runs whose valid-pair rate is too low are under-trained and left out. Runs whose training seed is unknown are
    no seeds of anything.

    Raises:
        ValueError: If two runs are one seed: the same checkpoint, or the same training seed of one setting.
    """
    members: dict[str, list[Run]] = {}
    for run in runs:
        members.setdefault(family_key(run.gate), []).append(run)
    families = []
    for group in members.values():
        _refuse_duplicates(group)
        trained = [run for run in group if run.first.readable or run.first.partition != "ring"]
        seeds = [run for run in trained if run.training.seed is not None]
        if len(seeds) > 1:
            families.append(
                summarise_family(
                    _common_label([run.name for run in seeds]),
                    [run.first for run in seeds],
                    seeds=[run.training.seed for run in seeds if run.training.seed is not None],
                    loss=settled([run.training for run in seeds]),
                )
            )
    return families


def _refuse_duplicates(group: Sequence[Run]) -> None:
    """Refuse runs of one setting that are one seed under two names."""
    seen: dict[Any, Run] = {}
    for run in group:
        seed, checkpoint = run.training.seed, run.training.checkpoint
        identities: list[tuple[str, Any]] = []
        if checkpoint is not None:
            identities.append(("the same checkpoint", checkpoint))
        if seed is not None:
            identities.append((f"the training seed {seed} of one setting", seed))
        if not identities:
            identities.append(
                ("the same counts", gate_digest(replace(run.gate, provenance=_without_seed(run.gate.provenance))))
            )
        for what, identity in identities:
            other = seen.setdefault((what, identity), run)
            if other is not run:
                raise ValueError(
                    f"{other.name!r} and {run.name!r} hold {what}, expected every seed once: leave one out "
                    "(of a pack with `dualhead report --only`), or merge two evaluations of a checkpoint with "
                    "dualhead_eval.gate.merge.merge_gates"
                )


def _common_label(labels: Sequence[str]) -> str:
    """The seeds' labels without what tells them apart, for example ``"token"`` of ``"token seed 0"``."""
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*labels, strict=False))
    common = "".join(letters[0] for letters in same).rstrip(" -_/,.([0123456789")
    return common.removesuffix("seed").rstrip(" -_/,.([") or labels[0]
