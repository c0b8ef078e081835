"""Labels beside points that neither overlap each other nor hide the points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

#: Directions tried around a point (degrees), sideways first because text is wide.
_ANGLES = (0, 180, 30, -30, 150, -150, 60, -60, 120, -120, 90, -90)
_RADII = (9, 16, 26, 38, 52, 68, 86, 106, 130)


def place_labels(ax: Axes, x: Sequence[float], y: Sequence[float], labels: Sequence[str], size: float = 8) -> None:
    """Annotate the points of ``ax`` (data coordinates), moving each label to a free spot near its point.

    Limits of the axes must be final. Each label takes the nearest candidate position that lies inside the
    axes and meets no other label or point; distant ones get a thin leader line.
    """
    figure = ax.figure
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    scale = figure.dpi / 72
    frame = ax.get_window_extent(renderer)
    points = ax.transData.transform(np.column_stack([x, y]))
    taken = [np.array([px - 4 * scale, py - 4 * scale, px + 4 * scale, py + 4 * scale]) for px, py in points]
    placed: list[np.ndarray] = []
    for index in np.argsort(-points[:, 1], kind="stable"):
        text = ax.annotate(
            labels[index],
            (x[index], y[index]),
            xytext=(0, 0),
            textcoords="offset points",
            fontsize=size,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            zorder=5,
        )
        extent = text.get_window_extent(renderer)
        width, height = extent.width, extent.height
        best, least = None, np.inf
        for radius in _RADII:
            for angle in _ANGLES:
                dx, dy = (
                    radius * np.cos(np.radians(angle)) * scale,
                    radius * np.sin(np.radians(angle)) * scale,
                )
                left = points[index, 0] + dx - (0 if dx > 1e-6 else width if dx < -1e-6 else width / 2)
                low = points[index, 1] + dy - height / 2
                box = np.array([left, low, left + width, low + height])
                outside = max(0.0, frame.x0 - box[0]) + max(0.0, box[2] - frame.x1)
                outside += max(0.0, frame.y0 - box[1]) + max(0.0, box[3] - frame.y1)
                # Labels of higher points were placed before and should stay above.
                inverted = sum(box[0] < other[2] and other[0] < box[2] and box[1] > other[1] for other in placed)
                cost = radius * scale + 50 * outside + 40 * inverted
                cost += 100 * sum(_overlap(box, other) for other in taken)
                if cost < least:
                    best, least = box, cost
        assert best is not None
        taken.append(best)
        placed.append(best)
        offset = (best[:2] - points[index]) / scale
        text.set_position((float(offset[0]), float(offset[1])))
        nearest = np.clip(points[index], best[:2], best[2:])
        nearest[1] = (best[1] + best[3]) / 2
        if np.hypot(*(nearest - points[index])) > 12 * scale:
            line = ax.transData.inverted().transform([points[index], nearest])
            ax.plot(line[:, 0], line[:, 1], color="0.6", linewidth=0.6, zorder=2)


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Length scale (pixels) of the overlap of two boxes (x0, y0, x1, y1), 0 if they are apart."""
    wide = min(a[2], b[2]) - max(a[0], b[0])
    high = min(a[3], b[3]) - max(a[1], b[1])
    return float(np.sqrt(wide * high)) if wide > 0 and high > 0 else 0.0
