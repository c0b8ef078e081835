"""Discrete tokens that both heads see: where they come from, how often they occur, how they are drawn."""

from __future__ import annotations

import numpy as np
import torch
from sklearn.cluster import KMeans
from torch import Tensor, nn
from torch.nn import functional

from dualhead_policy.model.token_corruption import TokenCorruption

#: Rows used to fit k-means; more change the centroids by less than their own spread.
MAX_CLUSTERED_ROWS = 50_000
#: Starts of k-means, of which the tightest clustering is kept.
K_MEANS_STARTS = 10
#: Metres; an axis along which nothing moves is not blown up.
SMALLEST_SCALE = 1e-4


class TokenTable(nn.Module):
    """Tokens 0..n-1 with their training frequencies and, for window tokens, their centroids.

    Args:
        n_tokens: Number of tokens.
        width: Flattened size of what k-means tokens cluster (positions of a window or of a whole transport), or 0.
        displacement_axes: None to cluster absolute positions. d to cluster what a window does, wherever it is: its
            d-dimensional positions less the first, each axis divided by the positions' standard deviation over the
            training windows, so that a short axis counts as much as a long one.

    Buffers:
        marginal: Frequency of every token in training (n_tokens,).
        centroids: k-means centroids (n_tokens, width), metres, or scaled displacements.
        axis_scale: Standard deviation of the positions along each axis (d,), metres; with displacements only.
    """

    marginal: Tensor
    centroids: Tensor
    axis_scale: Tensor

    def __init__(self, n_tokens: int, width: int, displacement_axes: int | None = None):
        super().__init__()
        self.n_tokens = n_tokens
        self.displacement_axes = displacement_axes
        self.register_buffer("marginal", torch.full((n_tokens,), 1 / n_tokens))
        self.register_buffer("centroids", torch.zeros(n_tokens, width))
        if displacement_axes is not None:
            self.register_buffer("axis_scale", torch.ones(displacement_axes))

    def fit_clusters(self, rows: np.ndarray, seed: int, *, what: str) -> Tensor:
        """Cluster the training data's positions (N, points * d) in metres, by k-means.

        Args:
            rows: Windows (families J, J' of tab:main) or whole transport trajectories (families H, I).
            seed: Seed of k-means.
            what: What a row is, for the error.

        Returns:
            The token of every row (N,).

        Raises:
            ValueError: If there are fewer distinct rows than tokens.
        """
        rng = np.random.default_rng(seed)
        if self.displacement_axes is not None:
            points = torch.from_numpy(rows.astype(np.float32)).unflatten(1, (-1, self.displacement_axes))
            self.axis_scale.copy_(points.std(dim=(0, 1)).clamp_min(SMALLEST_SCALE))
        clustered = self._features(torch.from_numpy(rows.astype(np.float32))).numpy()
        if len(rows) > MAX_CLUSTERED_ROWS:
            clustered = clustered[rng.choice(len(rows), MAX_CLUSTERED_ROWS, replace=False)]
        if len(np.unique(clustered[: 10 * self.n_tokens], axis=0)) < self.n_tokens:
            raise ValueError(
                f"the dataset has fewer distinct {what} than policy.n_tokens={self.n_tokens}: record more "
                "episodes or ask for fewer tokens"
            )
        kmeans = KMeans(self.n_tokens, n_init=K_MEANS_STARTS, random_state=int(rng.integers(2**31))).fit(clustered)
        self.centroids.copy_(torch.from_numpy(kmeans.cluster_centers_.astype(np.float32)))
        token = torch.cat([self.assign(part) for part in torch.from_numpy(rows.astype(np.float32)).split(65_536)])
        self.fit_marginal(token)
        return token

    def fit_marginal(self, tokens: Tensor) -> TokenTable:
        """Set the training frequencies from the training tokens (N,)."""
        counts = torch.bincount(tokens.long(), minlength=self.n_tokens).to(torch.float32)
        self.marginal.copy_(counts / counts.sum())
        return self

    def assign(self, position: Tensor) -> Tensor:
        """Tokens (B,): the nearest centroid of every row of positions (B, ...) in metres."""
        return torch.cdist(self._features(position.flatten(1)), self.centroids).argmin(dim=1)

    def _features(self, rows: Tensor) -> Tensor:
        """What is clustered, of positions (B, points * d) in metres."""
        if self.displacement_axes is None:
            return rows
        return (_displacement(rows, self.displacement_axes) / self.axis_scale).flatten(1)

    def draw(self, shape: tuple[int, ...], draw: str, generator: torch.Generator | None) -> Tensor:
        """Draw tokens of ``shape``, ``"uniform"`` or from the training ``"marginal"``."""
        device = generator.device if generator is not None else torch.device("cpu")
        if draw == "uniform":
            return torch.randint(self.n_tokens, shape, generator=generator, device=device)
        weights = self.marginal.to(device)
        count = int(np.prod(shape))
        return torch.multinomial(weights, count, replacement=True, generator=generator).reshape(shape)

    def corrupt(
        self,
        token: Tensor,
        corruption: TokenCorruption,
        *,
        replacement_prob: float | Tensor,
        null_prob: float | Tensor,
    ) -> Tensor:
        """Training-time corruption of tokens (B,).

        With ``replacement_prob`` a token becomes a uniformly random token (the paper's token dropout); with
        ``null_prob`` it becomes the null token, numbered ``n_tokens``.
        """
        token = torch.where(corruption.chance < replacement_prob, corruption.replacement, token)
        return torch.where(corruption.chance >= 1 - null_prob, self.n_tokens, token)

    def one_hot(self, token: Tensor) -> Tensor:
        """One-hot code (..., n_tokens); the null token is all zeros."""
        return functional.one_hot(token, self.n_tokens + 1)[..., : self.n_tokens].to(torch.float32)


def _displacement(rows: Tensor, axes: int) -> Tensor:
    """Positions (B, points * axes) less the row's first, (B, points, axes)."""
    points = rows.unflatten(1, (-1, axes))
    return points - points[:, :1]
