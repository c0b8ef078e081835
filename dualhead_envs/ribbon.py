"""A predicted path as a picture shows it: a ribbon in the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

#: Okabe and Ito's colours, which the colour-blind can tell apart: one per mode, in turn.
MODE_COLORS = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (230, 159, 0),
    (148, 103, 189),
    (110, 110, 110),
)
#: What reaches no mode.
NO_MODE_COLOR = (150, 150, 150)


def mode_color(mode: int) -> tuple[int, int, int]:
    """RGB of a mode, 0..K-1; grey of -1."""
    return MODE_COLORS[mode % len(MODE_COLORS)] if mode >= 0 else NO_MODE_COLOR


@dataclass(frozen=True, eq=False)
class Ribbon:
    """A path to draw into a scene.

    Attributes:
        points: Positions (H, d) in metres, world frame.
        color: RGB, 0 to 255.
        beads: Whether it is a string of beads instead of one unbroken ribbon.
        opacity: 1 opaque, towards 0 transparent.
        width: Width relative to the usual one.
    """

    points: np.ndarray
    color: tuple[int, int, int]
    beads: bool = False
    opacity: float = 1.0
    width: float = 1.0


#: Opacity of pairs that are not executed, and what it is multiplied by where a path reaches no mode.
_OTHERS, _WITHOUT_MODE = 0.4, 0.6
#: Width of the executed pair.
_EXECUTED_WIDTH = 1.8


def pair_ribbons(first: ArrayLike, second: ArrayLike, first_modes: ArrayLike, second_modes: ArrayLike) -> list[Ribbon]:
    """Both heads' sampled paths of one decision as ribbons, coloured by mode.

    The first head's are unbroken, the second's are strings of beads. The pair with index 0, whose chunk is executed, is
    wider and opaque, and comes last, so that it lies on top where a picture has no depth.

    Args:
        first: The first head's paths (n, H, d) in metres.
        second: The second head's.
        first_modes: The first head's modes (n,), -1 for none.
        second_modes: The second head's.
    """
    executed, others = [], []
    for beads, paths, modes in ((False, first, first_modes), (True, second, second_modes)):
        for index, (points, mode) in enumerate(zip(np.asarray(paths), np.asarray(modes), strict=True)):
            color, faint = mode_color(int(mode)), 1.0 if mode >= 0 else _WITHOUT_MODE
            if index == 0:
                executed.append(Ribbon(points, color, beads, width=_EXECUTED_WIDTH))
            else:
                others.append(Ribbon(points, color, beads, opacity=_OTHERS * faint))
    return others + executed


def drawable(ribbons: Sequence[Ribbon], width: int) -> list[Ribbon]:
    """The ribbons of finite points of ``width`` coordinates.

    Raises:
        ValueError: If one has another shape.
    """
    for ribbon in ribbons:
        if ribbon.points.ndim != 2 or ribbon.points.shape[1] != width:
            raise ValueError(f"a ribbon has points {ribbon.points.shape}, expected (H, {width}) in metres")
    return [ribbon for ribbon in ribbons if len(ribbon.points) > 1 and np.isfinite(ribbon.points).all()]
