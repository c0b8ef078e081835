"""From what a policy observed and sampled to a decision: the same code beside the robot and on recorded rollouts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.counts import INVALID
from dualhead_eval.evaluation.labelled_pairs import ModePartition
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.kinematics import position_map

#: Names of the observed dimensions that are the measured position, in the order of preference.
SITES = (("position.x", "position.y", "position.z"), ("x", "y"))


class DecisionBuilder:
    """Makes decisions of one environment and policy.

    Args:
        kinematic_map: Name of the map from head A's space to the position, e.g. ``"panda"``.
        state_names: Names of the dimensions of the proprioception.
        control: The head whose chunks are executed.
        partition: The environment's mode partition, or None to leave labels out.
        flag: Says of an observation whether two modes are open, or None.
    """

    def __init__(
        self,
        kinematic_map: str,
        state_names: Sequence[str] | None,
        control: str,
        partition: ModePartition | None = None,
        flag: Callable[[NDArray[np.float64]], bool] | None = None,
    ) -> None:
        self.decode = position_map(kinematic_map)
        self.control, self.partition, self.flag = control, partition, flag
        names = list(state_names or [])
        found = next((site for site in SITES if set(site) <= set(names)), ())
        self.site = [names.index(name) for name in found]

    def build(
        self,
        step: int,
        state: ArrayLike,
        environment_state: ArrayLike,
        joint: ArrayLike,
        position: ArrayLike,
        *,
        token: int | None = None,
        diverged: ArrayLike | None = None,
    ) -> Decision:
        """One decision.

        Args:
            step: Control step, from 0.
            state: Proprioception ``(S,)``.
            environment_state: Task context ``(E,)``.
            joint: Head A's samples ``(n, H, d_A)``.
            position: Head B's samples ``(n, H, d)`` in m.
            token: Shared token of the executed pair.
            diverged: Pairs whose flow left the training range ``(n,)``.

        Raises:
            ValueError: If the samples are not two such arrays of one n and H.
        """
        raw, context = np.asarray(state, dtype=np.float64), np.asarray(environment_state, dtype=np.float64)
        a, b = np.asarray(joint, dtype=np.float64), np.asarray(position, dtype=np.float64)
        if a.ndim != 3 or b.ndim != 3 or a.shape[:2] != b.shape[:2]:
            raise ValueError(
                f"samples have shapes {a.shape} and {b.shape}, expected (n, H, d_A) and (n, H, d) with one n and H"
            )
        observation = np.concatenate([raw, context])
        with np.errstate(all="ignore"):  # a chunk that is not finite is counted as diverged, not warned about
            decoded = self.decode(a)
        labels = sides = None
        if self.partition is not None:
            labels, sides = _labelled(self.partition, decoded, b, context)
        return Decision(
            step=step,
            observation=observation,
            joint=a,
            position=b,
            decoded=decoded,
            site=raw[self.site] if self.site else None,
            control=self.control,
            token=token,
            labels=labels,
            sides=sides,
            diverged=None if diverged is None else np.asarray(diverged, dtype=bool),
            flagged=None if self.flag is None else self.flag(observation),
        )


def _labelled(
    partition: ModePartition, decoded: NDArray[np.float64], position: NDArray[np.float64], context: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Labels and sides ``(2, n)`` of both heads' paths; -1 where a path is not finite."""
    labels, sides = [], []
    for paths in (decoded, position):
        finite = np.asarray(np.isfinite(paths).all(axis=(1, 2)))
        side, strength = partition.score(np.where(finite[:, None, None], paths, 0.0), context)
        sides.append(np.where(finite, side, INVALID))
        labels.append(np.where(finite & (strength >= partition.tau), side, INVALID))
    return np.stack(labels), np.stack(sides)
