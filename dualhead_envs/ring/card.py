"""The geometry card of a ring dataset: how far apart the modes are, and whether a shortcut tells them.

A path's 36 scalar features are its 32 coordinates in the world frame, each axis' mean, and each axis' value
where it is largest in size (the paper counts as many: appendix "Testbed and environment specification").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from dualhead_envs.layout import Layout
from dualhead_envs.recording.episode import Episode
from dualhead_envs.ring.geometry import HORIZON

#: What the paper reports (appendix "Testbed and environment specification").
PAPER = {"mode_gap_cv": 0.1767, "single_feature_auroc": 0.5253}

#: What each row of the card means, in the order in which they are shown.
MEANINGS = {
    "train_paths": "paths to train on, each under a condition of its own",
    "held_out_conditions": "conditions in val and in test together, each shown in every mode",
    "rejections": "paths left out: none, so that the data are the mixture that the exact reference knows",
    "valid_share_train": "share of the paths in train that the partition gives a mode, whichever",
    "valid_share_val": "... in val",
    "valid_share_test": "... in test: no policy can be expected to be valid more often than its data",
    "other_mode_share": "share of all paths that the partition gives another mode than the expert meant",
    "mode_gap_mean_mm": "distance between the two nearest modes of a held-out condition, mean over the path",
    "mode_gap_sd_mm": "... its standard deviation over conditions",
    "mode_gap_cv": "... and the ratio of the two",
    "single_feature_auroc": "best AUROC of one scalar of a training path for a mode; 0.5 is no shortcut",
}


def ring_card(env_id: str, splits: Mapping[str, Sequence[Episode]], layout: Layout) -> dict[str, Any]:
    """The card of the episodes of train, val and test: measured values, the paper's, and what they mean."""
    episodes = [episode for split in splits.values() for episode in split]
    modes = np.array([episode.mode for episode in episodes])
    labels = np.array([episode.extra["label"] for episode in episodes])
    gaps = np.array([_mode_gap(group, layout) for split in ("val", "test") for group in _by_pair(splits[split])])
    feature, auroc = strongest_feature(
        np.array([_path(episode, layout) for episode in splits["train"]]),
        np.array([episode.mode for episode in splits["train"]]),
    )
    measured = {
        "train_paths": len(splits["train"]),
        "held_out_conditions": len(gaps),
        "rejections": 0,
        **{
            f"valid_share_{split}": float(np.mean([episode.extra["label"] >= 0 for episode in members]))
            for split, members in splits.items()
        },
        "other_mode_share": float(((labels >= 0) & (labels != modes)).mean()),
        "mode_gap_mean_mm": float(gaps.mean()),
        "mode_gap_sd_mm": float(gaps.std(ddof=1)),
        "mode_gap_cv": float(gaps.std(ddof=1) / gaps.mean()),
        "single_feature_auroc": auroc,
    }
    return {
        "format": "dualhead-card/1",
        "env_id": env_id,
        "horizon": HORIZON,
        "measured": {key: measured[key] for key in MEANINGS},
        "paper": PAPER,
        "single_feature": feature,
        "meanings": MEANINGS,
    }


def strongest_feature(paths: np.ndarray, modes: np.ndarray) -> tuple[str, float | None]:
    """The scalar feature of a path that alone tells a mode from the others best, pooled over conditions.

    Args:
        paths: Positions (n, 16, 2) in metres.
        modes: Modes (n,).

    Returns:
        The feature's name and its AUROC from 0.5 to 1; ``("", None)`` if there is but one mode.
    """
    peak = np.take_along_axis(paths, np.abs(paths).argmax(axis=1, keepdims=True), axis=1)[:, 0]
    features = np.concatenate([paths.reshape(len(paths), -1), paths.mean(axis=1), peak], axis=1)
    names = [f"{axis} at step {h}" for h in range(paths.shape[1]) for axis in "xy"]
    names += ["mean x", "mean y", "peak x", "peak y"]
    ranks = features.argsort(axis=0).argsort(axis=0) + 1.0
    best: tuple[str, float | None] = ("", None)
    for mode in np.unique(modes):
        chosen = modes == mode
        n, rest = int(chosen.sum()), int((~chosen).sum())
        if not rest:
            continue
        auroc = (ranks[chosen].sum(axis=0) - n * (n + 1) / 2) / (n * rest)
        auroc = np.maximum(auroc, 1 - auroc)
        strongest = int(auroc.argmax())
        if best[1] is None or auroc[strongest] > best[1]:
            best = (names[strongest], float(auroc[strongest]))
    return best


def _mode_gap(episodes: Sequence[Episode], layout: Layout) -> float:
    """Distance in millimetres between the two nearest of ``episodes``, each the mean over its steps."""
    paths = [_path(episode, layout) for episode in episodes]
    return 1e3 * min(np.linalg.norm(a - b, axis=-1).mean() for a, b in combinations(paths, 2))


def _by_pair(episodes: Sequence[Episode]) -> list[list[Episode]]:
    groups: dict[int, list[Episode]] = {}
    for episode in episodes:
        groups.setdefault(episode.pair, []).append(episode)
    return list(groups.values())


def _path(episode: Episode, layout: Layout) -> np.ndarray:
    return episode.action[:, layout.action_slices["position"]].astype(np.float64)
