"""The README's moving picture: recorded episodes of two policies side by side, both heads' predictions in the scene.

    dualhead record --env BimodalBypass-v2 --pairs 500 --root data/v2
    dualhead train --config_path=configs/v2/A_independent.yaml --dataset.root=data/v2/train --steps=4000 --output_dir=outputs/A
    dualhead train --config_path=configs/v2/K_oracle.yaml --dataset.root=data/v2/train --steps=4000 --output_dir=outputs/K
    for P in A K; do dualhead evaluate --policy outputs/$P --dataset data/v2/test --control position --samples 9 \
        --episodes 12 --record rollouts/$P --output $P.gate.json; done
    python docs/images/both_ways.py rollouts/A rollouts/K --episodes 1 6 --episodes 1 0
"""  # noqa: E501

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.evaluation.decision_pictures import LINE
from dualhead_eval.evaluation.films import rollout_frames

SIZE = 640
#: What is cut from a film's picture: the table and the arm.
CUT = (10, 140, 490, 560)
TITLES = ("The heads share nothing", "The heads share a token")
#: Steps between two frames, and the first that is shown.
STEP, START = 4, 68
#: Milliseconds of a frame, and of those in which the ways part.
USUAL, SLOW, SLOW_FRAMES = 110, 420, 8
HEADER, HELD = 34, 1200


def episode(root: Path, number: int, title: str) -> list[np.ndarray]:
    """Frames of an episode, framed."""
    ((_, pictures, _),) = rollout_frames(root, [number], stride=STEP, start=START, size=SIZE)
    ended = next(at for at in range(len(pictures)) if (pictures[at:] == pictures[at]).all())
    return [framed(picture, title) for picture in pictures[: ended + 1]]


def framed(picture: np.ndarray, title: str) -> np.ndarray:
    """The cut picture with its title above and its line beneath."""
    left, top, right, bottom = CUT
    image = Image.new("RGB", (right - left, HEADER + bottom - top + LINE), (255, 255, 255))
    ImageDraw.Draw(image).text((10, 7), title, (28, 33, 38), ImageFont.load_default(18))
    image.paste(Image.fromarray(picture[top:bottom, left:right]), (0, HEADER))
    image.paste(Image.fromarray(picture[SIZE:, : right - left]), (0, HEADER + bottom - top))
    return np.asarray(image)


def side_by_side(panels: list[list[np.ndarray]]) -> tuple[list[Image.Image], list[int]]:
    """Frames of several episodes beside each other, and how long each is shown; an episode that ends waits."""
    length = max(map(len, panels))
    frames = [
        Image.fromarray(np.concatenate([part[min(at, len(part) - 1)] for part in panels], axis=1))
        for at in range(length)
    ]
    return frames, [*(SLOW if at < SLOW_FRAMES else USUAL for at in range(length - 1)), HELD]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rollouts", type=Path, nargs=2)
    parser.add_argument("--episodes", type=int, nargs="+", action="append", required=True)
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("both_ways.webp"))
    args = parser.parse_args()
    frames, durations = [], []
    for numbers in zip(*args.episodes, strict=True):
        panels = [episode(*inputs) for inputs in zip(args.rollouts, numbers, TITLES, strict=True)]
        shown, milliseconds = side_by_side(panels)
        frames, durations = frames + shown, durations + milliseconds
    film = io.BytesIO()
    frames[0].save(
        film, "WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=60, method=6
    )
    write_bytes(args.output, film.getvalue())
    print(f"{args.output}: {len(frames)} frames, {len(film.getvalue()) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
