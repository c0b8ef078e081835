"""Labels of points in a column beside the axes, in the points' order, so that no two ever meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression

#: Distance of two lines of text, in font sizes.
LINE = 1.35


def spaced(positions: ArrayLike, gap: float, low: float = 0.0, high: float = 1.0) -> NDArray[np.float64]:
    """Positions at least ``gap`` apart, in their order and as near as possible to those given.

    Args:
        positions: Wanted positions ``(n,)``, increasing.
        gap: Smallest distance of neighbours.
        low: Lower end of the room.
        high: Upper end of the room; where n positions do not fit, the gap shrinks.

    >>> spaced([0.5, 0.5, 0.9], gap=0.2).round(2).tolist()
    [0.4, 0.6, 0.9]
    """
    wanted = np.asarray(positions, dtype=np.float64)
    if wanted.size == 0:
        return wanted
    gap = min(gap, (high - low) / max(1, wanted.size - 1))
    steps = gap * np.arange(wanted.size)
    return np.clip(isotonic_regression(wanted - steps).x, low, high - steps[-1]) + steps


def label_beside(ax: Axes, x: Sequence[float], y: Sequence[float], labels: Sequence[str], *, size: float = 8) -> None:
    """Write the points' labels in a column to the right of ``ax``, each joined to its point by a thin line.

    Limits of the axes and the size of its figure must be final.
    """
    order = np.lexsort([x, y])
    points = ax.transAxes.inverted().transform(ax.transData.transform(np.column_stack([x, y])))
    height = ax.get_window_extent().height / ax.figure.dpi * 72
    heights = spaced(points[order, 1], LINE * size / height)
    for index, at in zip(order, heights, strict=True):
        ax.annotate(
            labels[index],
            (x[index], y[index]),
            xytext=(1.03, float(at)),
            textcoords="axes fraction",
            fontsize=size,
            va="center",
            arrowprops={
                "arrowstyle": "-",
                "color": "0.6",
                "linewidth": 0.5,
                "shrinkA": 1,
                "shrinkB": 3,
                "relpos": (0, 0.5),
            },
            annotation_clip=False,
        )
