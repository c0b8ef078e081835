"""AUROC as a share of concordant pairs of a failed and a successful episode: stratified, time-matched, resampled.

``wins[i, j]`` counts the comparisons of failure i with success j in which the failure scores higher, ties one half;
``pairs[i, j]`` the comparisons. The AUROC is the ratio of their sums; comparisons that are not allowed (another
stratum, another time) are zero in both, and a bootstrap replicate is a weight per episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Successes and failures that a stratum needs to be compared.
FEWEST = 5


@dataclass(frozen=True)
class Concordance:
    """Comparisons of failures with successes.

    Attributes:
        wins: ``(F, S)``.
        pairs: ``(F, S)``.
        failures: Indices of the failed episodes ``(F,)``.
        successes: Indices of the successful ones ``(S,)``.
        left_out: Strata with too few of either.
    """

    wins: NDArray[np.float64]
    pairs: NDArray[np.float64]
    failures: NDArray[np.int64]
    successes: NDArray[np.int64]
    left_out: tuple[str, ...] = ()

    @property
    def auroc(self) -> float:
        """Share of concordant comparisons, NaN without any."""
        total = self.pairs.sum()
        return float(self.wins.sum() / total) if total > 0 else float("nan")

    def resampled(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """AUROC of every row of ``weights`` over episodes ``(draws, E)``."""
        f, s = weights[:, self.failures], weights[:, self.successes]
        top, bottom = ((f @ table * s).sum(axis=1) for table in (self.wins, self.pairs))
        return np.divide(top, bottom, out=np.full(len(weights), np.nan), where=bottom > 0)


def compare_scores(scores: ArrayLike, success: ArrayLike, strata: ArrayLike | None = None) -> Concordance:
    """Compare one score per episode ``(E,)``, larger when worse; within strata if given."""
    return compare_traces([np.array([score]) for score in np.asarray(scores, dtype=np.float64)], success, strata)


def compare_traces(
    traces: Sequence[NDArray[np.float64]], success: ArrayLike, strata: ArrayLike | None = None
) -> Concordance:
    """Compare running aggregates between episodes that are alive at the same decision; within strata if given.

    A signal that is a function of time alone ties in every comparison, and scores one half.
    """
    won = np.asarray(success, dtype=bool)
    failures, successes = np.flatnonzero(~won), np.flatnonzero(won)
    cells = np.zeros(len(won), dtype="<U1") if strata is None else np.asarray(strata, dtype=str)
    allowed = cells[failures][:, None] == cells[successes][None]
    left_out = []
    if strata is not None:
        for cell in np.unique(cells):
            if min((cells[failures] == cell).sum(), (cells[successes] == cell).sum()) < FEWEST:
                left_out.append(str(cell))
                allowed &= (cells[failures] != cell)[:, None]
    wins, pairs = (np.zeros(allowed.shape) for _ in range(2))
    longest = max((len(trace) for trace in traces), default=0)
    # Episodes that have ended are NaN: they win nothing, tie with nothing and are not counted.
    grid = np.full((len(traces), longest), np.nan)
    for row, trace in zip(grid, traces, strict=True):
        row[: len(trace)] = trace
    for column in grid.T:
        f, s = column[failures][:, None], column[successes][None]
        wins += (f > s) + 0.5 * (f == s)
        pairs += ~(np.isnan(f) | np.isnan(s))
    return Concordance(wins * allowed, pairs * allowed, failures, successes, tuple(left_out))
