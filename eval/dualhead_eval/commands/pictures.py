"""The pictures of ``dualhead evaluate``: both heads' predictions drawn into the scene."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dualhead_eval.evaluation.conditions import ConditionBank
    from dualhead_eval.evaluation.protocol import EvaluationProtocol
    from dualhead_eval.evaluation.samplers import EvaluatedSampler


def add_picture_options(parser: argparse.ArgumentParser) -> None:
    """Define what may be pictured."""
    pictures = parser.add_argument_group("pictures: joint head unbroken, position head as beads, coloured by mode")
    pictures.add_argument(
        "--preview",
        type=Path,
        metavar="FILE.png",
        help="with --policy or --exact: both heads' predictions under the first six conditions",
    )
    pictures.add_argument(
        "--video",
        type=Path,
        metavar="FOLDER",
        help="with --record or --rollouts: films of the first ten episodes with the predictions of every decision",
    )


def show_preview(
    args: argparse.Namespace, sampler: EvaluatedSampler, conditions: ConditionBank, protocol: EvaluationProtocol
) -> None:
    """Write the contact sheet, if one was asked for."""
    if args.preview is not None:
        from dualhead_eval.evaluation.preview import write_preview

        write_preview(sampler, conditions, protocol, args.preview)
        print(f"preview: {args.preview}")


def require_films(args: argparse.Namespace, env_id: str, env_kwargs: Mapping[str, Any]) -> None:
    """Refuse, before episodes are rolled out, films that could not be made of them."""
    if args.video is not None:
        from dualhead_eval.evaluation.films import open_filmed

        open_filmed(env_id, env_kwargs, args.dataset).close()


def show_films(args: argparse.Namespace) -> None:
    """Write the films of ``args.rollouts``, if they were asked for."""
    if args.video is not None:
        from tqdm import tqdm

        from dualhead_eval.evaluation.films import film_rollouts

        with tqdm(unit="film", desc="filming", delay=1) as bar:
            films = film_rollouts(args.rollouts, args.video, progress=bar.update)
        print(f"{len(films)} films: {args.video}")
