"""A picture of a ring, drawn on the CPU with Pillow: no OpenGL, no window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from dualhead_envs.ribbon import Ribbon, drawable, mode_color
from dualhead_envs.ring import geometry
from dualhead_envs.ring.partition import RingPartition

SIZE = 480  # pixels, each side of the image
_OVERSAMPLE = 2  # drawn larger, then averaged: Pillow's shapes have no smooth edges of their own
_HALF_WIDTH = 1.75  # metres from the centre to the image's edge

_PAPER, _INK, _RULE = (252, 251, 248), (45, 48, 56), (205, 204, 198)


def draw_ring(
    path: np.ndarray, condition: np.ndarray, partition: RingPartition, ribbons: Sequence[Ribbon] = ()
) -> np.ndarray:
    """Draw the ring, its modes and ``path``, coloured by the mode that ``partition`` gives it so far.

    Args:
        path: Points so far (T, 2) in metres; the agent started at the origin.
        condition: ``(cos theta, sin theta, r)``.
        partition: Gives the modes' directions, the threshold and the label.
        ribbons: Predicted paths to draw too.

    Returns:
        RGB image (480, 480, 3) uint8, x to the right and y upwards.
    """
    image = Image.new("RGB", (SIZE * _OVERSAMPLE, SIZE * _OVERSAMPLE), _PAPER)
    draw = ImageDraw.Draw(image)
    radius = float(condition[2])
    directions = geometry.mode_directions(condition, partition.angles)
    label = int(partition.assign(path, condition)) if len(path) else -1

    _circle(draw, (0, 0), radius, outline=_RULE, width=3)
    _circle(draw, (0, 0), partition.tau * radius, outline=_RULE, width=1)
    for k, direction in enumerate(directions):
        colour = mode_color(k)
        centre = radius * direction
        draw.line([_pixel((0, 0)), _pixel(centre)], fill=_blend(colour, 0.25), width=_OVERSAMPLE)
        # One and two standard deviations of the expert's paths at their apex.
        _circle(draw, centre, 2 * geometry.PATH_SPREAD, fill=_blend(colour, 0.15))
        _circle(draw, centre, geometry.PATH_SPREAD, fill=_blend(colour, 0.35 if k != label else 0.8))
        draw.text(_pixel(centre + 0.27 * direction), str(k), fill=colour, font=_font(15), anchor="mm")

    for ribbon in drawable(ribbons, 2):
        _draw_ribbon(draw, ribbon)
    colour = mode_color(label) if label >= 0 else _INK
    points = np.vstack([np.zeros((1, 2)), path]).clip(-2 * _HALF_WIDTH, 2 * _HALF_WIDTH)
    draw.line([_pixel(p) for p in points], fill=colour, width=3 * _OVERSAMPLE, joint="curve")
    for point in points[:-1]:
        _circle(draw, point, 0.022, fill=_PAPER, outline=colour, width=1)
    _circle(draw, points[-1], 0.05, fill=colour, outline=_PAPER, width=2)

    verdict = f"mode {label}" if label >= 0 else "undecided" if len(path) < geometry.HORIZON else "no valid mode"
    left, right, top = 0.05 * SIZE, 0.95 * SIZE, 0.05 * SIZE
    draw.text((left * _OVERSAMPLE, top * _OVERSAMPLE), f"step {len(path)}/{geometry.HORIZON}", _INK, _font(15), "lm")
    draw.text((right * _OVERSAMPLE, top * _OVERSAMPLE), verdict, colour, _font(15), "rm")
    return np.asarray(image.resize((SIZE, SIZE), Image.Resampling.BOX)).copy()


def _draw_ribbon(draw: ImageDraw.ImageDraw, ribbon: Ribbon) -> None:
    colour, points = _blend(ribbon.color, ribbon.opacity), ribbon.points.clip(-2 * _HALF_WIDTH, 2 * _HALF_WIDTH)
    if ribbon.beads:
        for point in points:
            _circle(draw, point, 0.016 * ribbon.width, fill=colour)
    else:
        draw.line(
            [_pixel(p) for p in points], fill=colour, width=round(1.5 * ribbon.width) * _OVERSAMPLE, joint="curve"
        )


def _pixel(point: np.ndarray | tuple[float, float]) -> tuple[float, float]:
    scale = SIZE * _OVERSAMPLE / (2 * _HALF_WIDTH)
    return (float(point[0]) + _HALF_WIDTH) * scale, (_HALF_WIDTH - float(point[1])) * scale


def _circle(
    draw: ImageDraw.ImageDraw,
    centre: np.ndarray | tuple[float, float],
    radius: float,
    fill: tuple[int, int, int] | None = None,
    outline: tuple[int, int, int] | None = None,
    width: int = 1,
) -> None:
    x, y = _pixel(centre)
    r = radius * SIZE * _OVERSAMPLE / (2 * _HALF_WIDTH)
    draw.ellipse([x - r, y - r, x + r, y + r], fill=fill, outline=outline, width=width * _OVERSAMPLE)


def _blend(colour: tuple[int, int, int], share: float) -> tuple[int, int, int]:
    red, green, blue = (round(share * c + (1 - share) * p) for c, p in zip(colour, _PAPER, strict=True))
    return red, green, blue


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size * _OVERSAMPLE)
