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
from dualhead_eval.evaluation.films import SIZE, rollout_frames

#: What is cut from a film's picture: the table and the arm.
CUT = (45, 70, 435, 400)
TITLES = ("The heads share nothing", "The heads share a token")
STEP, START, HELD = 4, 52, 5  # shown steps, the first of them, and frames for which an end is held
HEADER = 34


def panel(root: Path, episodes: list[int], title: str) -> list[np.ndarray]:
    """Frames of the episodes, one after the other, under a title."""
    frames: list[np.ndarray] = []
    for _, pictures, _ in rollout_frames(root, episodes, stride=STEP, start=START):
        frames += [framed(picture, title) for picture in pictures[: np.flatnonzero(_changes(pictures))[-1] + 2]]
        frames += [frames[-1]] * HELD
    return frames


def _changes(pictures: np.ndarray) -> np.ndarray:
    return np.array([(a != b).any() for a, b in zip(pictures[1:], pictures[:-1], strict=True)])


def framed(picture: np.ndarray, title: str) -> np.ndarray:
    """The cut picture with its title above and its line beneath."""
    left, top, right, bottom = CUT
    image = Image.new("RGB", (right - left, HEADER + bottom - top + LINE), (255, 255, 255))
    ImageDraw.Draw(image).text((10, 7), title, (28, 33, 38), ImageFont.load_default(18))
    image.paste(Image.fromarray(picture[top:bottom, left:right]), (0, HEADER))
    image.paste(Image.fromarray(picture[SIZE:, : right - left]), (0, HEADER + bottom - top))
    return np.asarray(image)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rollouts", type=Path, nargs=2)
    parser.add_argument("--episodes", type=int, nargs="+", action="append", required=True)
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("both_ways.webp"))
    args = parser.parse_args()
    panels = [panel(*inputs) for inputs in zip(args.rollouts, args.episodes, TITLES, strict=True)]
    length = max(map(len, panels))
    frames = [
        Image.fromarray(np.concatenate([part[min(at, len(part) - 1)] for part in panels], axis=1))
        for at in range(length)
    ]
    film = io.BytesIO()
    frames[0].save(film, "WEBP", save_all=True, append_images=frames[1:], duration=150, loop=0, quality=60, method=6)
    write_bytes(args.output, film.getvalue())
    print(f"{args.output}: {length} frames, {len(film.getvalue()) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
