"""LeRobot's statistics of a dataset, for many episodes at once.

LeRobot computes an episode's quantiles from a histogram of 5000 bins a dimension, one episode at a time (some
milliseconds each), and a dataset's statistics as their weighted means. These functions give the same
numbers, the histogram's rounding included, without building the histograms (tests compare the two).
"""

from __future__ import annotations

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_BINS = 5000

#: By statistic; each array has the dimension last.
Statistics = dict[str, np.ndarray]


def episode_statistics(values: np.ndarray) -> Statistics:
    """Statistics of n episodes of one length.

    Args:
        values: One feature (n, T, d), in the type in which LeRobot would see it.

    Returns:
        ``min``, ``max``, ``mean``, ``std`` and the quantiles (n, d), ``count`` (n, 1).
    """
    values = values.astype(np.result_type(values.dtype, np.float32), copy=False)
    n, steps, _ = values.shape
    mean = values.mean(axis=1)
    statistics = {"min": values.min(axis=1), "max": values.max(axis=1), "mean": mean}
    if steps < 2:
        statistics["std"] = np.zeros_like(mean)
    else:
        statistics["std"] = np.sqrt(np.maximum(0, (values**2).mean(axis=1) - mean**2))
    statistics["count"] = np.full((n, 1), steps, dtype=np.int64)
    ordered = np.sort(values, axis=1).transpose(1, 0, 2).reshape(steps, -1)
    for key, quantile in QUANTILES.items():
        statistics[key] = _histogram_quantile(ordered, quantile).reshape(n, -1) if steps > 1 else mean.copy()
    return statistics


def _histogram_quantile(ordered: np.ndarray, quantile: float) -> np.ndarray:
    """The quantile (n,) that LeRobot's histogram of each column of ``ordered`` (T, n), sorted, gives."""
    low, high = ordered[0] - 1e-10, ordered[-1] + 1e-10
    step = (high - low) / _BINS

    def edge(index: np.ndarray, of: np.ndarray | slice = np.s_[:]) -> np.ndarray:
        # As numpy.linspace rounds: multiples of the step added to the start, and the end itself at the end.
        return np.where(index == _BINS, high[of], index.astype(low.dtype) * step[of] + low[of])

    # The bin in which the histogram's cumulative count reaches the target is that of an order statistic.
    target = quantile * len(ordered)
    value = ordered[max(int(np.ceil(target)), 1) - 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        # In a histogram of no width everything falls into the last bin.
        guess = np.nan_to_num((value - low) / step, nan=_BINS - 1)
    index = np.clip(guess.astype(np.int64), 0, _BINS - 1)
    above = np.flatnonzero((value >= edge(index + 1)) & (index < _BINS - 1))
    while len(above):
        index[above] += 1
        at = index[above]
        above = above[(value[above] >= edge(at + 1, above)) & (at < _BINS - 1)]
    below = np.flatnonzero((value < edge(index)) & (index > 0))
    while len(below):
        index[below] -= 1
        at = index[below]
        below = below[(value[below] < edge(at, below)) & (at > 0)]

    left, right = edge(index), edge(index + 1)
    before = (ordered < left).sum(axis=0)
    up_to = np.where(index == _BINS - 1, len(ordered), (ordered < right).sum(axis=0))
    fraction = (target - before) / np.maximum(up_to - before, 1)
    return np.where(index == 0, low, left + fraction * (right - left))


def aggregate(statistics: Statistics) -> Statistics:
    """The dataset's statistics (d,) from those of its episodes (n, d), as LeRobot aggregates them."""
    count = statistics["count"]
    total = count.sum(axis=0)
    mean = (statistics["mean"] * count).sum(axis=0) / total
    variance = ((statistics["std"] ** 2 + (statistics["mean"] - mean) ** 2) * count).sum(axis=0) / total
    aggregated = {
        "min": statistics["min"].min(axis=0),
        "max": statistics["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": total,
    }
    return aggregated | {key: (statistics[key] * count).sum(axis=0) / total for key in QUANTILES}
