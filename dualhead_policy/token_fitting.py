"""Fit a policy's tokens to its training data, when the policy is built."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.dataset_frames import read_split
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.tokens import TokenTable


def episode_modes(root: str | Path) -> Tensor:
    """Mode of every demonstration of a dataset split, by episode index (episodes,).

    Raises:
        ValueError: If the dataset has no ``mode`` column, or an episode has no valid mode.
    """
    frames = read_split(root)
    if "mode" not in frames.labels:
        raise ValueError(
            f"{root} has no 'mode' column, which the oracle token needs: record it with `dualhead record`, or "
            "use policy.token=window"
        )
    modes = np.full(int(frames.episode_index.max()) + 1, -1, dtype=np.int64)
    modes[frames.episode_index] = frames.labels["mode"]
    if (modes < 0).any():
        raise ValueError(
            f"episode {int(np.argmin(modes))} of {root} has no valid mode: drop it or record the dataset again"
        )
    return torch.from_numpy(modes)


def fit_tokens(config: DualheadConfig, root: str | Path, position: slice) -> TokenTable:
    """Build the tokens of a new policy from its training split; resolves ``config.n_tokens``.

    Args:
        config: The policy's configuration, with a token.
        root: Folder of the training split.
        position: Where the position lies in the dual action vector.

    Raises:
        ValueError: If the dataset has more modes than oracle tokens, or too few windows to cluster.
    """
    modes = episode_modes(root) if config.token == "oracle" or config.n_tokens is None else None
    if modes is not None and config.n_tokens is None:
        config.n_tokens = max(2, int(modes.max()) + 1)
    assert config.n_tokens is not None
    if config.token == "oracle" and modes is not None:
        if int(modes.max()) >= config.n_tokens:
            raise ValueError(
                f"the dataset has mode {int(modes.max())} but policy.n_tokens={config.n_tokens}: give at least "
                f"{int(modes.max()) + 1} tokens"
            )
        return TokenTable(config.n_tokens, 0).fit_marginal(modes)
    frames = read_split(root)
    starts = frames.window_starts(config.chunk_size)
    windows = frames.action[starts[:, None] + np.arange(config.chunk_size), position].reshape(len(starts), -1)
    seed = config.seed if config.seed is not None else 0
    return TokenTable(config.n_tokens, windows.shape[1]).fit_windows(windows, seed)
