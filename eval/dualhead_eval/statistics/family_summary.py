"""Families: the seeds of one mechanism found among runs, and their summary with the seed as the unit."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.gate import Gate
from dualhead_eval.statistics.bootstrap import Equivalence
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.run_summary import RunSummary
from dualhead_eval.statistics.seeds import seed_equivalence, seed_t_interval

#: Provenance that may differ between the seeds of one family.
_PER_SEED = {"label", "seed", "training", "seeds", "path", "run", "merged_from"}
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
    """

    label: str
    runs: tuple[RunSummary, ...]
    mean: dict[str, float]
    sd: dict[str, float]
    rho_ratio_of_means: float
    rho_interval: Interval | None
    equivalence: Equivalence | None
    occupancy: Occupancy


def summarise_family(label: str, runs: Sequence[RunSummary]) -> FamilySummary:
    """Family mean over seeds.

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
    )


def family_key(gate: Gate) -> str:
    """What two gates must share to be seeds of one mechanism: everything but the seed and what follows from it."""
    provenance = {key: value for key, value in gate.provenance.items() if key not in _PER_SEED}
    if isinstance(provenance.get("config"), dict):
        provenance["config"] = {k: v for k, v in provenance["config"].items() if k not in _PER_SEED}
    return json.dumps([gate.heads, gate.n_modes, provenance], sort_keys=True, default=str)


def find_families(runs: Iterable[Run]) -> list[FamilySummary]:
    """Families with two or more readable seeds, first pair of heads, in the order of their first run."""
    members: dict[str, list[RunSummary]] = {}
    for run in runs:
        if run.first.readable:
            members.setdefault(family_key(run.gate), []).append(run.first)
    return [
        summarise_family(_common_label([seed.label for seed in seeds]), seeds)
        for seeds in members.values()
        if len(seeds) > 1
    ]


def _common_label(labels: Sequence[str]) -> str:
    """The seeds' labels without what tells them apart, for example ``"token"`` of ``"token seed 0"``."""
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*labels, strict=False))
    common = "".join(letters[0] for letters in same).rstrip(" -_/,.([0123456789")
    return common.removesuffix("seed").rstrip(" -_/,.([") or labels[0]
