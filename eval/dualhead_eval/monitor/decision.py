"""A decision of a two-head policy as a monitor sees it, and an episode of decisions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Decision:
    """What a policy knew and predicted when it decided. Sample 0 of both heads is the executed pair.

    Attributes:
        step: Control step at which it decided, from 0.
        observation: Raw observation ``(D,)``, proprioception and task context one after the other.
        joint: Head A's sampled chunks ``(n, H, d_A)``, rad on robots; None where only the observation is known.
        position: Head B's sampled chunks ``(n, H, d)`` in m.
        decoded: Head A's chunks through the kinematic map ``(n, H, d)`` in m.
        site: Measured position of what the heads move, ``(d,)`` in m; None if the observation does not hold it.
        control: The head whose chunk is executed: ``"joint"``, or any other name for head B.
        token: Shared token of the executed pair, or None.
        labels: Modes of both heads' samples ``(2, n)``, -1 invalid; None without a mode partition.
        sides: The same without a threshold: the nearest mode of every sample, however little it deviates; -1 if the
            sample is not finite.
        diverged: Pairs ``(n,)`` whose flow left the range of the training chunks; None if the policy does not say.
        flagged: Whether two modes were open here (:mod:`dualhead_eval.monitor.branch_flag`); None if nobody looked.
        members: Decoded chunks of the members of an ensemble ``(M, n, H, d)`` in m, or None.
        member_fields: Differences of their velocity fields ``(M, M, n)``
            (:func:`dualhead_eval.ensembles.scores.vfd_score`), or None.
    """

    step: int
    observation: Array
    joint: Array | None = None
    position: Array | None = None
    decoded: Array | None = None
    site: Array | None = None
    control: str = "joint"
    token: int | None = None
    labels: NDArray[np.int64] | None = None
    sides: NDArray[np.int64] | None = None
    diverged: NDArray[np.bool_] | None = None
    flagged: bool | None = None
    members: Array | None = None
    member_fields: Array | None = None

    @property
    def pair(self) -> tuple[Array, Array]:
        """Both heads' samples as positions ``(n, H, d)`` in m.

        Raises:
            ValueError: If the decision holds no predictions.
        """
        if self.decoded is None or self.position is None:
            raise ValueError(
                f"the decision at step {self.step} holds no predictions of both heads, expected prediction.joint and "
                "prediction.position: record rollouts with `dualhead evaluate --record`"
            )
        return self.decoded, self.position

    @property
    def chunk(self) -> Array:
        """The executed chunk as positions ``(H, d)`` in m."""
        decoded, position = self.pair
        return decoded[0] if self.control == "joint" else position[0]

    @property
    def crossed(self) -> bool | None:
        """Whether the executed pair lies on two sides; None without a mode partition."""
        if self.sides is None:
            return None
        a, b = self.sides[:, 0]
        return bool(a != b and min(a, b) >= 0)


@dataclass(frozen=True)
class Episode:
    """The decisions of one episode and what became of it.

    Attributes:
        decisions: In their order.
        success: Whether the task was solved.
        failure: Why not: ``"none"`` after a success, else a word (``"collision"``, ``"timeout"``, ...).
        stratum: Kind and level of the perturbation, ``"nominal"`` without one.
        steps: Control steps until the episode ended.
        onset: Control step at which the perturbation set in, or None.
        key: What tells it from every other episode, for example the folder and its number.
    """

    decisions: tuple[Decision, ...] = field(repr=False)
    success: bool
    failure: str = "none"
    stratum: str = "nominal"
    steps: int = 0
    onset: int | None = None
    key: str = ""
