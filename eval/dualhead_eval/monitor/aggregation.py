"""From the scores of an episode so far to the number that is compared with the threshold.

Running aggregates: the value after decision t uses the scores up to t alone. ``step`` is the score itself;
``ewma-max`` the largest exponentially weighted mean so far, ``window-max`` and ``window-mean`` those of the last
decisions, ``mean`` and ``max`` of all. A score that is not finite counts as infinite: such a decision diverged and
ranks above all others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

#: Weight of the newest score in an exponentially weighted mean.
EWMA_WEIGHT = 0.1
#: Decisions of a window.
WINDOW = 5

#: What a running aggregate is: given the scores of an episode one by one, its value after each.
_Step = Callable[[float], float]


def _running_step() -> _Step:
    return lambda score: score


def _running_max() -> _Step:
    largest = -inf

    def add(score: float) -> float:
        nonlocal largest
        largest = max(largest, score)
        return largest

    return add


def _running_mean() -> _Step:
    total, count = 0.0, 0

    def add(score: float) -> float:
        nonlocal total, count
        total, count = total + score, count + 1
        return total / count

    return add


def _running_ewma_max() -> _Step:
    average, largest = None, -inf

    def add(score: float) -> float:
        nonlocal average, largest
        average = score if average is None else (1 - EWMA_WEIGHT) * average + EWMA_WEIGHT * score
        largest = max(largest, average)
        return largest

    return add


def _running_window(combine: Callable[[list[float]], float]) -> Callable[[], _Step]:
    def start() -> _Step:
        last: list[float] = []

        def add(score: float) -> float:
            last.append(score)
            del last[:-WINDOW]
            return combine(last)

        return add

    return start


_STARTS: dict[str, Callable[[], _Step]] = {
    "step": _running_step,
    "ewma-max": _running_ewma_max,
    "window-max": _running_window(max),
    "window-mean": _running_window(lambda last: sum(last) / len(last)),
    "mean": _running_mean,
    "max": _running_max,
}
#: Names of the aggregates.
AGGREGATES = tuple(_STARTS)


@dataclass
class Aggregator:
    """A running aggregate of one episode.

    >>> aggregator = Aggregator("max")
    >>> [aggregator.add(score) for score in (2.0, 1.0, 3.0)]
    [2.0, 2.0, 3.0]

    Args:
        name: One of :data:`AGGREGATES`.

    Raises:
        ValueError: If there is no such aggregate.
    """

    name: str

    def __post_init__(self) -> None:
        if self.name not in _STARTS:
            raise ValueError(f"aggregate {self.name!r} is not known, expected one of {AGGREGATES}: choose one of these")
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._add = _STARTS[self.name]()

    def add(self, score: float) -> float:
        """The aggregate after one more decision."""
        return self._add(score if isfinite(score) else inf)


def running(name: str, scores: Iterable[float]) -> NDArray[np.float64]:
    """The aggregate after every decision of one episode ``(T,)``."""
    aggregator = Aggregator(name)
    return np.array([aggregator.add(float(score)) for score in scores])
