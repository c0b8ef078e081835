"""Fit a policy's tokens to its training data, when the policy is built."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sklearn.metrics import normalized_mutual_info_score
from torch import Tensor

from dualhead_envs.dataset_frames import SplitFrames, read_split
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.model.tokens import TokenTable

#: Points to which a transport trajectory, from the branch to the episode's end, is resampled.
TRANSPORT_POINTS = 64


@dataclass(frozen=True)
class FittedTokens:
    """A new policy's tokens.

    Attributes:
        table: Frequencies and centroids, kept in the checkpoint.
        episode_token: Token of every training episode (episodes,), or None for window tokens.
        transport: What episode tokens are assigned from (episodes, points, d), or None.
    """

    table: TokenTable
    episode_token: Tensor | None = None
    transport: Tensor | None = None


def make_token_table(config: DualheadConfig, position_dim: int) -> TokenTable:
    """The unfitted table of ``config``'s tokens, for positions of ``position_dim`` dimensions."""
    assert config.n_tokens is not None
    points = {"window": config.chunk_size, "episode": TRANSPORT_POINTS}.get(config.token or "", 0)
    moved = config.token_positions == "displacement"
    return TokenTable(config.n_tokens, points * position_dim, displacement_axes=position_dim if moved else None)


def episode_modes(frames: SplitFrames) -> np.ndarray:
    """Mode of every demonstration of a dataset split, by episode index (episodes,).

    Raises:
        ValueError: If the dataset has no ``mode`` column, or an episode has no valid mode.
    """
    if "mode" not in frames.labels:
        raise ValueError(
            f"{frames.root} has no 'mode' column, which the oracle token needs: record it with `dualhead record`, or "
            "use policy.token=window"
        )
    modes = np.full(int(frames.episode_index.max()) + 1, -1, dtype=np.int64)
    modes[frames.episode_index] = frames.labels["mode"]
    if (modes < 0).any():
        raise ValueError(
            f"episode {int(np.argmin(modes))} of {frames.root} has no valid mode: drop it or record the dataset again"
        )
    return modes


def transport_trajectories(frames: SplitFrames, position: slice) -> Tensor:
    """Positions from each episode's branch to its end, resampled evenly in time (episodes, points, d) in m.

    An episode without a branch step counts from its first frame.
    """
    trajectories = []
    branch = frames.labels.get("branch_step")
    for episode in range(int(frames.episode_index.max()) + 1):
        rows = np.flatnonzero(frames.episode_index == episode)
        start = 0 if branch is None else int(branch[rows[0]])
        path = frames.action[rows[start:], position].astype(np.float64)
        at = np.linspace(0, len(path) - 1, TRANSPORT_POINTS)
        columns = [np.interp(at, np.arange(len(path)), path[:, axis]) for axis in range(path.shape[1])]
        trajectories.append(np.stack(columns, axis=-1))
    return torch.from_numpy(np.stack(trajectories).astype(np.float32))


def new_tokens(config: DualheadConfig, position: slice, dataset_meta: Any | None) -> FittedTokens | None:
    """The tokens of a policy: fitted to its training data, or, without data, a table that a checkpoint will fill.

    Args:
        config: The policy's configuration.
        position: Where the position lies in the dual action vector.
        dataset_meta: Metadata of the training data, or None.

    Returns:
        The tokens; None for a policy without.

    Raises:
        ValueError: If there is neither data nor a number of tokens, and as :func:`fit_tokens` does.
    """
    if config.token is None:
        return None
    if dataset_meta is not None:
        return fit_tokens(config, dataset_meta.root, position)
    if config.n_tokens is None:
        raise ValueError("policy.n_tokens is missing from the configuration: give the number of tokens")
    return FittedTokens(make_token_table(config, position.stop - position.start))


def fit_tokens(config: DualheadConfig, root: str | Path, position: slice) -> FittedTokens:
    """Build the tokens of a new policy from its training split; resolves ``config.n_tokens`` and ``token_nmi``.

    Args:
        config: The policy's configuration, with a token.
        root: Folder of the training split.
        position: Where the position lies in the dual action vector.

    Raises:
        ValueError: If the dataset has more modes than oracle tokens, or too few windows or episodes to cluster.
    """
    frames = read_split(root)
    needs_modes = config.token == "oracle" or config.n_tokens is None
    has_modes = "mode" in frames.labels and (frames.labels["mode"] >= 0).all()
    modes = episode_modes(frames) if needs_modes or has_modes else None
    if config.n_tokens is None:
        assert modes is not None
        config.n_tokens = max(2, int(modes.max()) + 1)
    table = make_token_table(config, position.stop - position.start)
    if config.token == "oracle":
        assert modes is not None
        if int(modes.max()) >= config.n_tokens:
            raise ValueError(
                f"the dataset has mode {int(modes.max())} but policy.n_tokens={config.n_tokens}: give at least "
                f"{int(modes.max()) + 1} tokens"
            )
        token = torch.from_numpy(modes)
        return FittedTokens(table.fit_marginal(token), token)
    seed = config.seed if config.seed is not None else 0
    if config.token == "episode":
        transport = transport_trajectories(frames, position)
        token = table.fit_clusters(transport.flatten(1).numpy(), seed, what="episodes")
        config.token_nmi = None if modes is None else _mutual_information(modes, token)
        return FittedTokens(table, token, transport)
    starts = frames.window_starts(config.chunk_size)
    windows = frames.action[starts[:, None] + np.arange(config.chunk_size), position].reshape(len(starts), -1)
    token = table.fit_clusters(windows, seed, what="windows")
    if modes is not None:
        config.token_nmi = _mutual_information(modes[frames.episode_index[starts]], token)
    return FittedTokens(table)


def _mutual_information(modes: np.ndarray, token: Tensor) -> float:
    return float(normalized_mutual_info_score(modes, token.numpy()))
