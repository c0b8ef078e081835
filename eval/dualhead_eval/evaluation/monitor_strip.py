"""A strip beneath a film's pictures: a failure monitor's aggregate and threshold so far, and its alarm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

#: Recorded columns ``monitor.NAME`` that are drawn.
MONITORED = ("aggregate", "threshold", "alarm")
#: Height of the strip in pixels, and its margins.
HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 90, 90, 10, 12, 10
_PAPER, _INK, _SOFT, _SCORE, _LIMIT = "white", (34, 34, 34), (120, 120, 120), (31, 119, 180), (214, 39, 40)


def monitor_strip(width: int, aggregate: NDArray, threshold: NDArray, alarm: NDArray, step: int) -> NDArray[np.uint8]:
    """Pixels ``(HEIGHT, width, 3)`` of an episode's readings ``(T,)`` up to ``step``.

    The axis spans the whole episode from the start, so that lines grow and do not move; values above twice the largest
    threshold are drawn at the upper edge.
    """
    image = Image.new("RGB", (width, HEIGHT), _PAPER)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(13)
    finite = threshold[np.isfinite(threshold)]
    top = (
        2.0 * float(finite.max()) if finite.size else float(np.nanmax(np.append(aggregate[np.isfinite(aggregate)], 1)))
    )

    def place(at: int, value: float) -> tuple[float, float]:
        share = min(max(value / top if np.isfinite(value) else 1.0, 0.0), 1.0)
        x = LEFT + (width - LEFT - RIGHT) * at / max(1, len(aggregate) - 1)
        return x, HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share

    for values, colour, line in ((threshold, _LIMIT, 1), (aggregate, _SCORE, 2)):
        points = [place(at, float(values[at])) for at in range(step + 1)]
        if len(points) > 1:
            draw.line(points, fill=colour, width=line)
    draw.line([place(0, 0.0), place(len(aggregate) - 1, 0.0)], fill=_SOFT, width=1)
    raised = np.flatnonzero(alarm[: step + 1])
    draw.text((10, TOP), f"{aggregate[step]:.3g}", _SCORE, font)
    draw.text((10, TOP + 18), f"limit {threshold[step]:.3g}", _LIMIT, font)
    if raised.size:
        x = place(int(raised[0]), 0.0)[0]
        draw.line([(x, TOP), (x, HEIGHT - BOTTOM)], fill=_LIMIT, width=2)
        draw.text((10, TOP + 36), "ALARM", _LIMIT, font)
    else:
        draw.text((10, TOP + 36), "no alarm", _INK, font)
    return np.asarray(image)
