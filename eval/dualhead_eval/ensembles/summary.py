"""An ensemble's gate in numbers: whether its members choose modes together, and what its score is made of.

Every two members make a pair like two heads; an ensemble's figure is the mean over its pairs, and their range stands
beside it, since pairs that share a member are no independent repetitions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from dualhead_eval.gate import Gate
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.run_statistics import condition_sums

#: Statistics of the members' modes, and of the score between them.
CHOICES = ("obs", "delta", "delta_pooled", "capacity", "rho", "valid_rate")
SCORE = ("mean", "same", "cross", "cross_share", "auroc")


@dataclass(frozen=True)
class OverPairs:
    """A quantity over all pairs of members: mean and range of those that define it, NaN if none does."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class EnsembleSummary:
    """One gate of an ensemble at its reference point.

    Attributes:
        label: Name of the ensemble.
        members: Number of members.
        head: Which head of each was sampled.
        score: ``"action_l2"``, ``"vfd"`` or ``"vfd_unweighted"``.
        shared_noise: Whether all members started from one draw.
        unit: Of the score.
        pairs: Samples per condition and member.
        conditions: Number of conditions.
        over_pairs: Every quantity of :data:`CHOICES` and :data:`SCORE`; effects by the protocol's estimator
            (per condition, weighted by both-valid pairs), ``delta_pooled`` of all conditions' counts together (the
            accounting of tab:crn), ``cross_share`` the contamination, ``auroc`` within conditions.
    """

    label: str
    members: int
    head: str
    score: str
    shared_noise: bool
    unit: str
    pairs: int
    conditions: int
    over_pairs: Mapping[str, OverPairs]


def is_ensemble(gate: Gate) -> bool:
    """Whether a gate's heads are the members of an ensemble."""
    return gate.provenance.get("method") == "ensemble"


def summarise_ensemble(gate: Gate) -> EnsembleSummary:
    """Summary of an ensemble's gate.

    Raises:
        ValueError: If the gate is no ensemble's, or lacks the score between two members.
    """
    if not is_ensemble(gate):
        raise ValueError(f"gate {gate.label!r} is no ensemble's: write one with `dualhead ensemble`")
    values: dict[str, list[float]] = {name: [] for name in (*CHOICES, *SCORE)}
    units = set()
    for i, j in combinations(range(len(gate.heads)), 2):
        component = f"{gate.heads[i]} / {gate.heads[j]}"
        if component not in gate.strata:
            raise ValueError(f"gate {gate.label!r} lacks the score of {component!r}: write it again")
        sums = condition_sums(gate.pair_table(i, j), "plug-in")
        choices = sums.statistics(sums.total())
        score = summarise_strata(gate.strata[component].at(gate.index()))
        units.add(score.unit)
        for name in CHOICES:
            values[name].append(float(choices[name]))
        for name in SCORE:
            values[name].append(getattr(score, name))
    provenance = gate.provenance
    return EnsembleSummary(
        label=gate.label,
        members=len(gate.heads),
        head=str(provenance.get("head", "")),
        score=str(provenance.get("score", "action_l2")),
        shared_noise=bool(provenance.get("shared_noise")),
        unit=units.pop() if len(units) == 1 else "",
        pairs=int(gate.counts[0, 0, 0].sum()),
        conditions=len(gate.pair_ids),
        over_pairs={name: _over_pairs(found) for name, found in values.items()},
    )


def paper_ensemble(gate: Gate) -> str | None:
    """What the paper calls an ensemble of these members: b1_l0, b0_l0, b0_l3 or mixed objectives; None if nothing.

    Its ensembles are of families without token or latent on BimodalBypass-v2 (tab:crn).
    """
    members = gate.provenance.get("members")
    if gate.partition.get("name") != "bypass-v2" or not isinstance(members, Mapping) or not members:
        return None
    configurations = [_mapping(_mapping(member).get("config")) for member in members.values()]
    if any(config.get("token") or config.get("latent") for config in configurations):
        return None
    objectives = {
        (config.get("source_noise_beta", 1.0), config.get("consistency_weight", 0.0)) for config in configurations
    }
    if len(objectives) > 1:
        return "mixed objectives"
    return {(1.0, 0.0): "b1_l0", (0.0, 0.0): "b0_l0", (0.0, 3.0): "b0_l3"}.get(objectives.pop())


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _over_pairs(values: list[float]) -> OverPairs:
    defined = np.array([value for value in values if value == value])
    if not len(defined):
        return OverPairs(float("nan"), float("nan"), float("nan"))
    of: tuple[Callable[..., Any], ...] = (np.mean, np.min, np.max)
    return OverPairs(*(float(f(defined)) for f in of))
