"""What every signal is: a score per decision, what it learns beforehand, what it remembers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Decision

#: What a signal may need of a decision.
NEEDS = ("observation", "pairs", "samples", "memory", "labels", "members")


class Signal(ABC):
    """A signal of one decision at a time.

    Attributes:
        name: What commands and files call it.
        unit: Unit of the score.
        needs: A subset of :data:`NEEDS`: ``pairs`` one sampled pair, ``samples`` two or more, ``memory`` the
            decisions before.
        learns: Whether :meth:`fit` must see decisions before the first score.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    needs: ClassVar[frozenset[str]]
    learns: ClassVar[bool] = False

    def fit(self, decisions: Sequence[Decision], rng: np.random.Generator) -> None:  # noqa: B027
        """Learn from decisions of nominal successes; nothing by default."""

    def reset(self) -> None:  # noqa: B027
        """Begin an episode; forget the decisions before."""

    @abstractmethod
    def score(self, decision: Decision) -> float:
        """The decision's score, a float that is not finite if the decision is not."""

    def options(self) -> dict[str, Any]:
        """Arguments of the constructor, as JSON keeps them."""
        return {}

    def learned(self) -> dict[str, NDArray]:
        """What :meth:`fit` learned, as arrays by name."""
        return {}

    def restore(self, arrays: dict[str, NDArray]) -> None:  # noqa: B027
        """Take back what :meth:`learned` gave."""


def stacked_observations(decisions: Sequence[Decision]) -> NDArray[np.float64]:
    """Observations ``(N, D)`` of decisions.

    Raises:
        ValueError: If there is none.
    """
    if not decisions:
        raise ValueError("no decision to learn from, expected recorded successes: give more calibration episodes")
    return np.stack([np.asarray(decision.observation, dtype=np.float64) for decision in decisions])
