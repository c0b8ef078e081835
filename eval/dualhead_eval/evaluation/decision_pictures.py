"""A decision as a picture shows it: both heads' chunks as ribbons in the scene, and a line of text beneath it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from dualhead_envs.ribbon import Ribbon, mode_color, pair_ribbons
from dualhead_eval.evaluation.labelled_pairs import ModePartition

#: Height of the line beneath a picture, in pixels.
LINE = 56
_PAPER, _INK, _SOFT = (255, 255, 255), (28, 33, 38), (100, 108, 116)


@dataclass(frozen=True)
class Decided:
    """What a picture shows of a decision.

    Attributes:
        ribbons: Both heads' chunks.
        words: Whether the pairs agree.
        heads: Each head's name and the mode that its executed chunk reaches, -1 for none.
    """

    ribbons: list[Ribbon]
    words: str
    heads: list[tuple[str, int]]


def decided(
    first: np.ndarray, second: np.ndarray, condition: np.ndarray, partition: ModePartition, *, held: int = 0
) -> Decided:
    """What a picture shows of one decision.

    Args:
        first, second: The joint head's and the position head's paths (n, H, d) in metres; pair 0 is executed.
        condition: ``environment_state`` (C,).
        partition: Gives the modes.
        held: How many of the first pairs are no draws of the decision's own: they are drawn and not counted.
    """
    modes = []
    for paths in (first, second):
        label, strength = partition.score(paths, np.broadcast_to(condition, (len(paths), len(condition))))
        modes.append(np.where(strength >= partition.tau, label, -1))
    reached = [int(labels[0]) for labels in modes]
    if min(reached) < 0:
        words = "no mode within reach" if max(reached) < 0 else "one head reaches a mode"
    else:
        words = "heads agree" if reached[0] == reached[1] else "heads disagree"
    drawn = [labels[held:] for labels in modes]
    valid = (drawn[0] >= 0) & (drawn[1] >= 0)
    if valid.any():
        words += f"; {int((valid & (drawn[0] == drawn[1])).sum())} of {int(valid.sum())} drawn pairs agree"
    heads = list(zip(("joint", "position"), reached, strict=True))
    return Decided(pair_ribbons(first, second, *modes), words, heads)


def under_line(picture: np.ndarray, moment: str, words: str, heads: list[tuple[str, int]]) -> np.ndarray:
    """A picture with a line of text beneath it: the moment, some words, and the mode of each head."""
    image = Image.new("RGB", (picture.shape[1], picture.shape[0] + LINE), _PAPER)
    image.paste(Image.fromarray(picture))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(15)
    top, left = picture.shape[0] + 9, 90
    draw.text((10, top), moment, _SOFT, font)
    draw.text((left, top), words, _INK, font)
    for beads, (head, mode) in enumerate(heads):
        shape = draw.ellipse if beads else draw.rectangle
        for k in range(5 if beads else 1):
            shape((left + 8 * k, top + 25, left + 8 * k + (6 if beads else 38), top + 31), fill=mode_color(mode))
        draw.text((left + 46, top + 18), f"{head}: mode {mode}" if mode >= 0 else f"{head}: none", _INK, font)
        left += 180
    return np.asarray(image)
