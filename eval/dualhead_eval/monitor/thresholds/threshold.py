"""What every threshold is: fitted on aggregates of successful episodes, then a limit for each decision."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Trace:
    """The aggregates of one calibration episode.

    Attributes:
        values: Aggregate after every decision ``(T,)``.
        flagged: Whether two modes were open at every decision ``(T,)``, or None.
    """

    values: NDArray[np.float64]
    flagged: NDArray[np.bool_] | None = None


class Threshold(ABC):
    """A limit that an aggregate must exceed for an alarm.

    Attributes:
        name: What commands and files call it.
        guarantee: What its fit guarantees, in words.
    """

    name: ClassVar[str]
    guarantee: str

    @abstractmethod
    def fit(self, traces: Sequence[Trace], alpha: float, rng: np.random.Generator) -> None:
        """Fit on episodes that all succeeded."""

    def needed(self, alpha: float) -> int:
        """Fewest calibration episodes with a finite limit."""
        return needed_episodes(alpha)

    @abstractmethod
    def at(self, index: int, flagged: bool | None = None) -> float:
        """The limit at decision ``index`` of an episode."""

    def options(self) -> dict[str, Any]:
        """Arguments of the constructor, as JSON keeps them."""
        return {}

    @abstractmethod
    def learned(self) -> dict[str, NDArray]:
        """What :meth:`fit` learned, as arrays by name."""

    @abstractmethod
    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take back what :meth:`learned` gave."""


def conformal_quantile(scores: ArrayLike, alpha: float) -> float:
    """The k-th smallest of n scores, k = ceil((n + 1)(1 - alpha)); infinite where k > n.

    An exchangeable further score exceeds it with probability at most alpha.

    >>> conformal_quantile(range(1, 20), 0.05), conformal_quantile(range(1, 19), 0.05)
    (19.0, inf)

    Raises:
        ValueError: If alpha is not inside (0, 1), or a score is NaN.
    """
    if not 0 < alpha < 1:
        raise ValueError(f"alpha={alpha}, expected a number between 0 and 1")
    values = np.sort(np.asarray(scores, dtype=np.float64))
    if np.isnan(values).any():
        raise ValueError("a calibration score is NaN, expected numbers: count a diverged decision as infinite")
    # Guard against (n + 1)(1 - alpha) landing a rounding error above an integer.
    k = ceil((values.size + 1) * (1 - alpha) - 1e-9)
    return inf if k > values.size else float(values[k - 1])


def needed_episodes(alpha: float) -> int:
    """Fewest calibration episodes with a finite threshold: ceil(1 / alpha) - 1."""
    return ceil(1 / alpha - 1e-9) - 1
