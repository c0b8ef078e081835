"""Sample pairs with the scores of their modes, before any threshold, and their residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dualhead_eval.residuals.distances import position_residual_mm, rotation_residual_deg, split_residual_mm

HEADS = ("joint", "position")
#: The third head, where a policy has one.
ROTATION = "rotation"


class ModePartition(Protocol):
    """What an environment knows of its modes; see ``env.unwrapped.mode_partition``."""

    n_modes: int
    tau: float

    def score(self, path: np.ndarray, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...

    def to_dict(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class LabelledPairs:
    """Everything that counts and strata need to know about sample pairs.

    Attributes:
        label: Mode of each head's path regardless of tau, by head, each (conditions, pairs).
        strength: What tau is compared with, by head, same shape; infinite for an orientation head, which is always
            valid.
        residuals: Mean distance of the two paths in mm by component, same shape: ``"position"``, and where the
            modes' direction is known its ``"position/lateral"`` part along it and ``"position/orthogonal"``; with an
            orientation head ``"rotation"``, its mean angle to the joint head's orientation in degrees.
    """

    label: Mapping[str, np.ndarray]
    strength: Mapping[str, np.ndarray]
    residuals: Mapping[str, np.ndarray]

    @classmethod
    def from_paths(
        cls,
        joint: np.ndarray,
        position: np.ndarray,
        condition: np.ndarray,
        partition: ModePartition,
        direction: np.ndarray | None = None,
        rotations: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> LabelledPairs:
        """Score paths (conditions, pairs, H, d) in metres.

        Args:
            joint: Head A's paths, mapped to positions.
            position: Head B's paths.
            condition: (conditions, C).
            partition: The environment's mode partition.
            direction: Direction that separates the modes of every condition (conditions, d), or None.
            rotations: Orientations as 6-D rotations (conditions, pairs, H, 6): those of the joint head, and the
                orientation head's own; or None. Their modes are told apart where the partition has a rule for it.
        """
        scores = [partition.score(path, condition[:, None]) for path in (joint, position)]
        residuals = {"position": position_residual_mm(joint, position)}
        if direction is not None:
            lateral, orthogonal = split_residual_mm(joint, position, direction[:, None])
            residuals |= {"position/lateral": lateral, "position/orthogonal": orthogonal}
        label, strength = ({head: score[i] for head, score in zip(HEADS, scores, strict=True)} for i in (0, 1))
        if rotations is not None:
            residuals[ROTATION] = rotation_residual_deg(*rotations)
            companion = getattr(partition, "assign_rotation", None)
            if companion is not None:
                label[ROTATION] = companion(rotations[1], condition[:, None])
                strength[ROTATION] = np.full(label[ROTATION].shape, np.inf)
        return cls(label, strength, residuals)

    @property
    def heads(self) -> tuple[str, ...]:
        """The heads whose modes are told apart."""
        return tuple(self.label)

    @classmethod
    def join(cls, parts: Sequence[LabelledPairs]) -> LabelledPairs:
        """Concatenate along the conditions."""
        return cls(
            {head: np.concatenate([part.label[head] for part in parts]) for head in parts[0].heads},
            {head: np.concatenate([part.strength[head] for part in parts]) for head in parts[0].heads},
            {name: np.concatenate([part.residuals[name] for part in parts]) for name in parts[0].residuals},
        )

    def at(self, tau: float) -> dict[str, np.ndarray]:
        """Labels of each head at threshold ``tau``, -1 below it."""
        return {head: np.where(self.strength[head] >= tau, self.label[head], -1) for head in self.heads}
