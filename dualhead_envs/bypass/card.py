"""The geometry card: what a recording's modes look like, beside what the paper says of its own two.

All lengths are in millimetres. The window is the 16 states after the branch point; per pair, the gap is the mean
over the window of the distance between the two demonstrations at the same step. Of three modes it is that of the two
nearest, and what describes one line between two modes is left out. The apex is where the expert's route turns; a
path's apex is its outermost point within the window. A demonstration is valid if its window reaches tau.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from dualhead_envs.bypass.partition import BypassPartition
from dualhead_envs.recording.episode import Episode

HORIZON = 16
FORMAT = "dualhead-card/1"
#: Columns of the dual action vector (see :mod:`dualhead_envs.bypass.layout`).
JOINTS, POSITION, ROTATION = slice(0, 7), slice(7, 10), slice(10, 16)

#: What the paper reports of its own data (sec:envs, app:prereg).
PAPER: dict[str, dict[str, float]] = {
    "BimodalBypass-v2": {
        "mode_gap_mean_mm": 143.68, "mode_gap_sd_mm": 0.66, "mode_gap_cv": 0.0046, "nonlateral_gap_mean_mm": 0.77,
        "endpoint_gap_max_mm": 0.25, "single_feature_auroc": 1.0,
    },
    "RotatingBypass-v3": {
        "mode_gap_mean_mm": 162.43, "mode_gap_sd_mm": 16.50, "mode_gap_cv": 0.1016, "apex_error_mean_mm": 4.27,
        "apex_error_max_mm": 6.50, "clearance_min_mm": 28.5, "rejections": 0, "separation_angle_min_deg": -33.8,
        "separation_angle_max_deg": 33.6, "separation_angle_sd_deg": 19.2, "lateral_share_min": 0.831,
        "lateral_share_mean": 0.945, "single_feature_auroc": 0.5586,
    },
}  # fmt: skip

#: What each row of the card means, in the order in which they are shown.
MEANINGS = {
    "pairs": "pairs kept (both modes succeeded)",
    "rejections": "initial states given up because a mode failed",
    "frames": "frames in all",
    "mode_gap_mean_mm": "distance between the modes in the window, mean over pairs",
    "mode_gap_sd_mm": "... its standard deviation over pairs",
    "mode_gap_cv": "... and the ratio of the two",
    "nonlateral_gap_mean_mm": "part of that distance that is not along y",
    "separation_angle_min_deg": "direction of the separation, from the lateral axis, smallest",
    "separation_angle_max_deg": "... largest",
    "separation_angle_sd_deg": "... its standard deviation",
    "lateral_share_min": "share of the separation that is along y, smallest",
    "lateral_share_mean": "... its mean",
    "endpoint_gap_max_mm": "distance between the two last states, largest",
    "apex_error_mean_mm": "distance of the path's apex from the commanded one, mean",
    "apex_error_max_mm": "... largest",
    "overshoot_mean_mm": "... the same, negative where the path stays inside, mean",
    "clearance_min_mm": "distance of anything that moves from the obstacle, smallest",
    "valid_share_train": "share of the demonstrations in train that the partition calls valid at its tau",
    "valid_share_val": "... in val",
    "valid_share_test": "... in test: no policy can be expected to be valid more often than its data",
    "single_feature_auroc": "best AUROC of one scalar of the window for the mode (v3: for the generator's A or B)",
}

#: Rows that describe the line along which two modes part.
SEPARATION_ROWS = (
    "nonlateral_gap_mean_mm", "separation_angle_min_deg", "separation_angle_max_deg", "separation_angle_sd_deg",
    "lateral_share_min", "lateral_share_mean",
)  # fmt: skip

#: What a row means where there are more than two modes.
SETS_MEANINGS = {
    "pairs": "initial states kept (every mode succeeded)",
    "mode_gap_mean_mm": "distance between the two nearest modes in the window, mean over initial states",
    "mode_gap_sd_mm": "... its standard deviation over initial states",
    "endpoint_gap_max_mm": "distance between two modes' last states, largest",
    "single_feature_auroc": "best AUROC of one scalar of the window for a mode against the others",
}

#: One demonstration a mode, in the modes' order, from one initial state.
Modes = tuple[Episode, ...]


def geometry_card(
    env_id: str,
    splits: Mapping[str, Sequence[Modes]],
    partition: BypassPartition,
    rejections: int,
    *,
    has_obstacle: bool = True,
) -> dict[str, Any]:
    """The card of train, val and test, lists of (mode 0, mode 1, ...): measured values, the paper's, and meanings."""
    pairs = [pair for split in splits.values() for pair in split]
    two_modes = list(combinations(range(partition.n_modes), 2))
    # (pairs of modes, initial states, window, 3)
    windows = np.array([[_window(episode)[:, POSITION] for episode in pair] for pair in pairs])
    gaps = np.stack([windows[:, i] - windows[:, j] for i, j in two_modes]) * 1e3
    distance = np.linalg.norm(gaps, axis=3).mean(axis=2).min(axis=0)
    last = np.array([[episode.action[-1, POSITION] for episode in pair] for pair in pairs])
    ends = np.stack([last[:, i] - last[:, j] for i, j in two_modes]) * 1e3
    apex = np.array([e.extra["apex_error"] for pair in pairs for e in pair]) * 1e3
    overshoot = np.array([e.extra["overshoot"] for pair in pairs for e in pair]) * 1e3
    clearance = np.array([e.extra["clearance"] for pair in pairs for e in pair]) * 1e3
    feature, auroc = _best_feature(pairs)
    spread = float(distance.std(ddof=min(1, len(pairs) - 1)))
    measured: dict[str, int | float | None] = {
        "pairs": len(pairs),
        "rejections": rejections,
        "frames": sum(len(episode) for pair in pairs for episode in pair),
        "mode_gap_mean_mm": float(distance.mean()),
        "mode_gap_sd_mm": spread,
        "endpoint_gap_max_mm": float(np.linalg.norm(ends, axis=2).max()),
        "apex_error_mean_mm": float(apex.mean()),
        "apex_error_max_mm": float(apex.max()),
        "overshoot_mean_mm": float(overshoot.mean()),
        "clearance_min_mm": float(clearance.min()) if has_obstacle else None,
        **{f"valid_share_{split}": _valid_share(split_pairs, partition) for split, split_pairs in splits.items()},
        "single_feature_auroc": auroc,
    }
    measured["mode_gap_cv"] = spread / float(distance.mean()) if distance.any() else None
    of_two = partition.n_modes == 2
    if of_two:
        # Modes that lie on each other part along no line.
        measured |= _separation(gaps[0]) if distance.all() else dict.fromkeys(SEPARATION_ROWS)
    meanings = (
        MEANINGS if of_two else {key: text for key, text in (MEANINGS | SETS_MEANINGS).items() if key in measured}
    )
    return {
        "format": FORMAT,
        "env_id": env_id,
        "horizon": HORIZON,
        "measured": {key: measured[key] for key in meanings},
        "paper": PAPER[env_id] if of_two and has_obstacle else {},
        "single_feature": feature,
        "meanings": meanings,
    }


def _separation(gaps: np.ndarray) -> dict[str, float]:
    """Along which line two modes part, of their differences (B, H, 3) in mm: :data:`SEPARATION_ROWS`."""
    separation = gaps.mean(axis=1)
    # An unordered pair has a separation axis, not a direction: it is turned to point to +y.
    angle = np.degrees(np.arctan(separation[:, 2] / separation[:, 1]))
    share = np.abs(separation[:, 1]) / np.linalg.norm(separation, axis=1)
    return {
        "nonlateral_gap_mean_mm": float(np.linalg.norm(gaps[..., [0, 2]], axis=2).mean()),
        "separation_angle_min_deg": float(angle.min()),
        "separation_angle_max_deg": float(angle.max()),
        "separation_angle_sd_deg": float(angle.std()),
        "lateral_share_min": float(share.min()),
        "lateral_share_mean": float(share.mean()),
    }


def _valid_share(pairs: Sequence[Modes], partition: BypassPartition) -> float:
    episodes = [episode for pair in pairs for episode in pair]
    windows = np.array([_window(episode)[:, POSITION] for episode in episodes])
    condition = np.array([episode.environment_state[0] for episode in episodes])
    return float((partition.assign(windows, condition) >= 0).mean())


def _window(episode: Episode) -> np.ndarray:
    """The 16 dual actions (16, 17) after the branch point: the measured states b + 1 .. b + 16."""
    return episode.action[episode.branch_step : episode.branch_step + HORIZON].astype(np.float64)


def _best_feature(pairs: Sequence[Modes]) -> tuple[str, float]:
    """The scalar of the window that tells the demonstrations apart best, and its AUROC (0.5 to 1).

    The paper's shortcut test (sec:envs): pooled over conditions, so that only a fixed coordinate can score. Scalars
    are mean, minimum, maximum and last value of every joint, coordinate and rotation entry. The label is the mode;
    in v3 it is the name, A or B, under which the generator drew the route. Of three modes, each in turn stands against
    the others.
    """
    windows = np.array([_window(episode)[:, :16] for pair in pairs for episode in pair])
    if len(pairs[0]) == 2:
        labels = [np.array([episode.extra["drawn_second"] for pair in pairs for episode in pair]) > 0.5]
    else:
        modes = np.array([episode.mode for pair in pairs for episode in pair])
        labels = [modes == mode for mode in range(len(pairs[0]))]
    windows = np.concatenate([windows[..., POSITION], windows[..., ROTATION], windows[..., JOINTS]], axis=-1)
    names = [f"position.{axis}" for axis in "xyz"] + [f"rotation.{i}" for i in range(6)]
    names += [f"joint.{i}" for i in range(7)]
    summaries = {
        "mean": windows.mean(axis=1), "min": windows.min(axis=1), "max": windows.max(axis=1), "last": windows[:, -1],
    }  # fmt: skip
    best = ("", 0.0)
    for summary, values in summaries.items():
        for name, column in zip(names, values.T, strict=True):
            score = max(_auroc(column, label) for label in labels)
            if score > best[1]:
                best = (f"{summary} of {name}", score)
    return best


def _auroc(values: np.ndarray, label: np.ndarray) -> float:
    """Area under the ROC curve of ``values`` (n,) for ``label`` (n,) in either direction; ties count half."""
    from scipy.stats import rankdata

    positive, negative = int(label.sum()), int((~label).sum())
    if not positive or not negative:
        return 0.5
    # Values that differ by float32's rounding alone are the same value.
    ranks = rankdata(np.round(values, 5))
    area = (ranks[label].sum() - positive * (positive + 1) / 2) / (positive * negative)
    return float(max(area, 1.0 - area))
