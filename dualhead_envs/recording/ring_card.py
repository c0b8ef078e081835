"""The geometry card of a ring dataset: how far apart the modes are, and whether a shortcut tells them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_envs.layout import Layout
from dualhead_envs.recording.episode import Episode
from dualhead_envs.recording.shards import write_atomically
from dualhead_envs.ring.partition import RingPartition


def write_ring_card(
    path: Path, splits: Mapping[str, Sequence[Episode]], layout: Layout, partition: RingPartition
) -> None:
    """Write the card of ``splits`` to ``path`` as JSON; every number comes with a sentence on its meaning."""
    card: dict[str, Any] = {"format": "dualhead-card/1", "partition": partition.to_dict(), "splits": {}}
    for split, episodes in splits.items():
        modes = np.array([episode.mode for episode in episodes])
        labels = np.array([episode.extra["label"] for episode in episodes])
        card["splits"][split] = {
            "episodes": len(episodes),
            "conditions": len({episode.pair for episode in episodes}),
            "mode_counts": np.bincount(modes, minlength=partition.n_modes).tolist(),
            "rejections": 0,
            "invalid_paths": int((labels < 0).sum()),
            "paths_of_another_mode": int(((labels >= 0) & (labels != modes)).sum()),
        }
    card["mode_gap"] = {
        "meaning": "largest distance over the window between two demonstrations of one condition (val and "
        "test), over all pairs of modes",
        **mode_gap([*splits["val"], *splits["test"]], layout),
    }
    card["single_feature_auroc"] = {
        "meaning": "strongest of the scalar features of a path (val and test excluded) as a test of one mode "
        "against the others; 0.5 is no shortcut",
        **strongest_feature(splits["train"], layout),
    }
    write_atomically(path, json.dumps(card, indent=4) + "\n")


def mode_gap(episodes: Sequence[Episode], layout: Layout) -> dict[str, float]:
    """Mean, standard deviation and coefficient of variation of the gap between modes, in millimetres."""
    by_pair: dict[tuple[float, ...], list[np.ndarray]] = {}
    for episode in episodes:
        condition = tuple(episode.environment_state[0].tolist())
        by_pair.setdefault(condition, []).append(_positions(episode, layout))
    gaps = 1e3 * np.array(
        [
            np.linalg.norm(a - b, axis=-1).max()
            for paths in by_pair.values()
            for a, b in combinations(paths, 2)
        ]
    )
    return {"mean_mm": gaps.mean(), "sd_mm": gaps.std(), "cv": gaps.std() / gaps.mean(), "pairs": len(gaps)}


def strongest_feature(episodes: Sequence[Episode], layout: Layout) -> dict[str, Any]:
    """The scalar feature of a path that alone tells a mode best, pooled over conditions, by AUROC.

    The features are the 32 coordinates of the path in the world frame, each axis' mean, and each axis' value
    where it is largest in size: 36 in all, as in the paper (appendix "Testbed"). An AUROC below one half
    counts as its complement.
    """
    paths = np.stack([_positions(episode, layout) for episode in episodes])
    modes = np.array([episode.mode for episode in episodes])
    peak = np.take_along_axis(paths, np.abs(paths).argmax(axis=1, keepdims=True), axis=1)[:, 0]
    features = np.concatenate([paths.reshape(len(paths), -1), paths.mean(axis=1), peak], axis=1)
    names = [f"{axis} at step {h}" for h in range(paths.shape[1]) for axis in "xy"]
    names += ["mean x", "mean y", "peak x", "peak y"]
    ranks = features.argsort(axis=0).argsort(axis=0) + 1.0
    best: dict[str, Any] = {"auroc": float("nan"), "feature": None, "mode": None, "features": len(names)}
    for mode in np.unique(modes):
        chosen = modes == mode
        n, rest = int(chosen.sum()), int((~chosen).sum())
        if not rest:
            continue
        auroc = (ranks[chosen].sum(axis=0) - n * (n + 1) / 2) / (n * rest)
        auroc = np.maximum(auroc, 1 - auroc)
        strongest = int(auroc.argmax())
        if not auroc[strongest] <= best["auroc"]:
            best |= {"auroc": float(auroc[strongest]), "feature": names[strongest], "mode": int(mode)}
    return best if best["feature"] else best | {"auroc": None}


def _positions(episode: Episode, layout: Layout) -> np.ndarray:
    return episode.action[:, layout.action_slices["position"]].astype(np.float64)
