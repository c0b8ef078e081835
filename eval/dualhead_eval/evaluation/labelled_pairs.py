"""Sample pairs with the scores of their modes, before any threshold, and their residuals; and their counts: a gate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np

from dualhead_eval.effects.counts import joint_table
from dualhead_eval.gate import Gate
from dualhead_eval.residuals.distances import position_residual_mm, rotation_residual_deg, split_residual_mm
from dualhead_eval.residuals.strata import residual_strata

HEADS = ("joint", "position")
#: The third head, where a policy has one.
ROTATION = "rotation"
#: Packages whose versions a gate's provenance names.
VERSIONED = ("lerobot_policy_dualhead", "lerobot", "torch", "numpy")


def installed_versions() -> dict[str, str]:
    """Versions of the packages that a gate's provenance names."""
    return {name: version(name) for name in VERSIONED}


class ModePartition(Protocol):
    """What an environment knows of its modes; see ``env.unwrapped.mode_partition``."""

    n_modes: int
    tau: float

    def score(self, path: np.ndarray, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...

    def to_dict(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class PairResidual:
    """Distance between two heads' samples of every pair.

    Attributes:
        distance: Mean over the window (conditions, pairs), at least 0.
        heads: The two heads whose modes stratify it.
        unit: One of :data:`dualhead_eval.residuals.strata.UNITS`.
    """

    distance: np.ndarray
    heads: tuple[str, str] = HEADS
    unit: str = "mm"


@dataclass(frozen=True)
class LabelledPairs:
    """Everything that counts and strata need to know about sample pairs.

    Attributes:
        label: Mode of each head's (or ensemble member's) path regardless of tau, by head, each (conditions, pairs).
        strength: What tau is compared with, by head, same shape; infinite for an orientation head, which is always
            valid.
        residuals: Residuals by component: ``"position"``, and where the modes' direction is known its
            ``"position/lateral"`` part along it and ``"position/orthogonal"``; with an orientation head
            ``"rotation"``, the angle to the joint head's orientation.
    """

    label: Mapping[str, np.ndarray]
    strength: Mapping[str, np.ndarray]
    residuals: Mapping[str, PairResidual]

    @classmethod
    def from_paths(
        cls,
        joint: np.ndarray,
        position: np.ndarray,
        condition: np.ndarray,
        partition: ModePartition,
        direction: np.ndarray | None = None,
        rotations: tuple[np.ndarray, np.ndarray] | None = None,
        *,
        heads: tuple[str, str] = HEADS,
        metres: bool = True,
    ) -> LabelledPairs:
        """Score both heads' paths (conditions, pairs, H, d).

        Args:
            joint: Head A's paths, mapped to positions; or a first draw's.
            position: Head B's paths; or a second draw's.
            condition: (conditions, C).
            partition: The environment's mode partition.
            direction: Direction that separates the modes of every condition (conditions, d), or None.
            rotations: Orientations as 6-D rotations (conditions, pairs, H, 6): those of the joint head, and the
                orientation head's own; or None. Their modes are told apart where the partition has a rule for it.
            heads: What the two are called.
            metres: Whether paths are in metres; if not, there are no residuals.
        """
        scores = [partition.score(path, condition[:, None]) for path in (joint, position)]
        label, strength = ({head: score[i] for head, score in zip(heads, scores, strict=True)} for i in (0, 1))
        residuals = {"position": PairResidual(position_residual_mm(joint, position), heads)} if metres else {}
        if metres and direction is not None:
            lateral, orthogonal = split_residual_mm(joint, position, direction[:, None])
            residuals["position/lateral"] = PairResidual(lateral, heads)
            residuals["position/orthogonal"] = PairResidual(orthogonal, heads)
        if rotations is not None:
            companion = getattr(partition, "assign_rotation", None)
            if companion is not None:
                label[ROTATION] = companion(rotations[1], condition[:, None])
                strength[ROTATION] = np.full(label[ROTATION].shape, np.inf)
            # Where no rule tells orientations apart, the positions' modes stratify their residual.
            strata = ("joint", ROTATION) if companion is not None else heads
            residuals[ROTATION] = PairResidual(rotation_residual_deg(*rotations), strata, "deg")
        return cls(label, strength, residuals)

    @property
    def heads(self) -> tuple[str, ...]:
        """The heads whose modes are told apart."""
        return tuple(self.label)

    @classmethod
    def join(cls, parts: Sequence[LabelledPairs]) -> LabelledPairs:
        """Concatenate along the conditions."""
        first = parts[0]
        return cls(
            {head: np.concatenate([part.label[head] for part in parts]) for head in first.heads},
            {head: np.concatenate([part.strength[head] for part in parts]) for head in first.heads},
            {
                name: replace(residual, distance=np.concatenate([part.residuals[name].distance for part in parts]))
                for name, residual in first.residuals.items()
            },
        )

    def at(self, tau: float) -> dict[str, np.ndarray]:
        """Labels of each head at threshold ``tau``, -1 below it."""
        return {head: np.where(self.strength[head] >= tau, self.label[head], -1) for head in self.heads}


def make_gate(
    pairs: Mapping[int, LabelledPairs],
    *,
    reference_nfe: int,
    taus: Sequence[float],
    conditions: np.ndarray,
    pair_ids: np.ndarray,
    partition: ModePartition,
    target_probabilities: Sequence[float] | None,
    provenance: Mapping[str, Any],
) -> Gate:
    """Count labelled pairs, by NFE, into a gate.

    Args:
        pairs: Labelled pairs for every NFE.
        reference_nfe: The NFE of headline numbers.
        taus: Further thresholds; the partition's own is always there and is the reference.
        conditions: Environment states (conditions, C).
        pair_ids: Pair of every condition.
        partition: The mode partition.
        target_probabilities: Mode frequencies of the data, or None.
        provenance: Where the pairs came from; versions and the partition are added.
    """
    nfes, all_taus = sorted(pairs), sorted({float(partition.tau), *map(float, taus)})
    heads, components = pairs[nfes[0]].heads, pairs[nfes[0]].residuals
    at = [[pairs[nfe].at(tau) for tau in all_taus] for nfe in nfes]
    labels = {head: np.stack([np.stack([point[head] for point in row]) for row in at]) for head in heads}
    strata = {
        name: residual_strata(
            np.stack([np.stack([pairs[nfe].residuals[name].distance] * len(all_taus)) for nfe in nfes]),
            *(labels[head] for head in component.heads),
            unit=component.unit,
        )
        for name, component in components.items()
    }
    return Gate(
        heads=heads,
        n_modes=partition.n_modes,
        taus=all_taus,
        nfes=nfes,
        reference_tau=float(partition.tau),
        reference_nfe=reference_nfe,
        counts=joint_table(list(labels.values()), partition.n_modes),
        conditions=np.asarray(conditions, dtype=np.float64),
        pair_ids=np.asarray(pair_ids, dtype=np.int64),
        target_probabilities=None if target_probabilities is None else np.asarray(target_probabilities),
        provenance={
            **provenance,
            "partition": partition.to_dict(),
            "versions": installed_versions(),
        },
        strata=strata,
    )
