"""Two columns of predicted paths in any LeRobotDataset, labelled by a partition of one's own: a gate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_envs.dataset_columns import read_columns, read_info
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, PairResidual, make_gate
from dualhead_eval.gate.gate import ROLLOUTS, Gate
from dualhead_eval.partitions.scored import ScoredPartition
from dualhead_eval.residuals.distances import position_residual_mm

#: True in the frames at which a policy decided; where it is missing every frame counts.
DECISION = "prediction.decision"
#: What a partition may read besides paths.
CONDITION = "observation.environment_state"


@dataclass(frozen=True)
class PredictedPaths:
    """The predictions of every decision of a dataset.

    Attributes:
        columns: Names of the two columns.
        paths: Paths of each column (decisions, n, H, d).
        condition: The dataset's ``observation.environment_state`` (decisions, C); C is 0 where it has none.
        episode: Episode of every decision (decisions,).
        root: The dataset's folder.
    """

    columns: tuple[str, str]
    paths: tuple[np.ndarray, np.ndarray]
    condition: np.ndarray
    episode: np.ndarray
    root: Path


def read_predictions(
    root: str | Path, columns: Sequence[str], *, samples: int | None = None, horizon: int | None = None
) -> PredictedPaths:
    """Read two prediction columns.

    Args:
        root: Folder of a LeRobotDataset v3.0.
        columns: Two features, both paths in the space of the partition: shaped (n, H, d) or (H, d), or flattened, which
            takes ``samples`` and ``horizon``.
        samples: Predictions n per decision, where a flattened feature does not say (1 by default).
        horizon: Steps H of a prediction, where a flattened feature does not say.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If a column is missing, not finite, or of another shape.
    """
    root = Path(root)
    info = read_info(root)
    features = info["features"]
    missing = [column for column in columns if column not in features]
    if missing:
        raise ValueError(f"{root} has no feature {missing[0]!r}, expected one of {sorted(features)}: check --columns")
    if len(set(columns)) != 2:
        raise ValueError(f"--columns names {list(columns)}, expected two different features: give one per head")
    optional = [key for key in (DECISION, CONDITION) if key in features]
    read = read_columns(root, info, [*columns, *optional, "episode_index"])
    decided = np.ones(len(read["episode_index"]), dtype=bool)
    if DECISION in read:
        decided = read[DECISION].reshape(-1).astype(bool)
    if not decided.any():
        raise ValueError(f"{root} holds no decision: expected {DECISION} to be true in some frames; record it again")
    shapes = [_shape(column, features[column]["shape"], samples, horizon) for column in columns]
    if shapes[0] != shapes[1]:
        raise ValueError(
            f"{columns[0]} holds predictions (n, H, d) = {shapes[0]} and {columns[1]} {shapes[1]}, expected the same: "
            "store both as paths in the space of the partition, for example joint angles through forward kinematics"
        )
    paths = [read[column][decided].reshape(-1, *shapes[0]).astype(np.float64) for column in columns]
    for column, path in zip(columns, paths, strict=True):
        if not np.isfinite(path).all():
            raise ValueError(f"{root} holds numbers in {column} that are not finite: drop or repair these predictions")
    condition = read[CONDITION][decided] if CONDITION in read else np.zeros((len(paths[0]), 0))
    return PredictedPaths(
        (columns[0], columns[1]),
        (paths[0], paths[1]),
        condition.reshape(len(paths[0]), -1).astype(np.float64),
        read["episode_index"][decided],
        root,
    )


def prediction_gate(
    predictions: PredictedPaths,
    partition: ScoredPartition,
    *,
    taus: Sequence[float] = (),
    metres: bool = False,
    label: str,
) -> Gate:
    """Count two prediction columns: every decision is a condition of its own, episodes are resampled together.

    Args:
        predictions: The paths.
        partition: What labels them.
        taus: Further thresholds; only for a partition with a score.
        metres: Whether paths are in metres; then the distance between both columns is counted too.
        label: Name of the run in tables.

    Raises:
        ValueError: If the partition cannot label the paths, or not at further thresholds.
    """
    if taus and not partition.has_score:
        raise ValueError("--tau needs a partition with score(path, condition), this one only assigns: leave --tau out")
    condition = predictions.condition[:, None]
    scores = [partition.score(path, condition) for path in predictions.paths]
    a, b = (column.removeprefix("prediction.") for column in predictions.columns)
    residuals = {"position": PairResidual(position_residual_mm(*predictions.paths), (a, b))} if metres else {}
    pairs = LabelledPairs({a: scores[0][0], b: scores[1][0]}, {a: scores[0][1], b: scores[1][1]}, residuals)
    described: dict[str, Any] = {"dataset": predictions.root.name, "columns": list(predictions.columns)}
    _, samples, horizon, _ = predictions.paths[0].shape
    return make_gate(
        {1: pairs},
        # How the predictions were integrated, if they were, is not known here.
        reference_nfe=1,
        taus=taus,
        conditions=predictions.condition,
        pair_ids=predictions.episode,
        partition=partition,
        target_probabilities=None,
        provenance={
            "label": label,
            "method": ROLLOUTS,
            "rollouts": {**described, "samples": samples, "horizon": horizon},
        },
    )


def _shape(column: str, shape: Sequence[int], samples: int | None, horizon: int | None) -> tuple[int, int, int]:
    """(n, H, d) of a column's predictions."""
    if len(shape) in (2, 3):
        n, steps, d = (1, *shape) if len(shape) == 2 else shape
        if samples not in (None, n) or horizon not in (None, steps):
            raise ValueError(
                f"{column} has shape {tuple(shape)}, expected {samples} samples of {horizon} steps: leave --samples "
                "and --horizon out, the dataset says both"
            )
        return n, steps, d
    width, n = math.prod(shape), 1 if samples is None else samples
    if horizon is None:
        raise ValueError(f"{column} is flat ({width} numbers), expected to be told its steps: give --horizon")
    if n < 1 or horizon < 1 or len(shape) != 1 or width % (n * horizon) or not width:
        raise ValueError(
            f"{column} holds {width} numbers, expected a multiple of {n} samples x {horizon} steps: correct --samples "
            "and --horizon"
        )
    return n, horizon, width // (n * horizon)
