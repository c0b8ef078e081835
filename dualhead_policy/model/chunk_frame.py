"""Coordinates in which a head's chunks are nearly white: what the observation predicts linearly is taken off.

The windows of a robot's motion are far from isotropic. Where the robot is dominates their variance and is
known from the observation; what remains lies near a few directions. A network that has to learn both
spends its capacity on cancelling noise (measured: with per-dimension scales alone the joint head keeps a third of
every joint's spread as noise after 3,000 steps).

With the mean m(c) = slope^T c + offset, a linear regression of the training windows x_1 on the preprocessed
observations c, and Q, the eigenvectors of the residuals' covariance, the frame is

    y_t = Q^T (x_t - t m(c)),   hence   y_1 = Q^T (x_1 - m(c))   and   y_0 = Q^T x_0.

Q is orthogonal, so y_0 is standard normal, |dy/dt - (y_1 - y_0)| = |dx/dt - (x_1 - x_0)| and Euler's method takes the
same steps: loss, minimiser and samples are those of the original coordinates. In the frame the coordinates of
y_1 are uncorrelated, with standard deviations ``spread`` for
:func:`dualhead_policy.model.network.gaussian_preconditioning`.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: Ridge of the regression, against the unit variance of the preprocessed observations.
RIDGE = 1e-3
#: How far beyond its training range the mean of a chunk may move, in widths of that range.
MEAN_MARGIN = 0.5


class ChunkFrame(nn.Module):
    """A head's frame; see the module.

    Buffers:
        slope (C, H * d), offset (H * d,): Mean of the normalised chunk given the preprocessed observation.
        basis (H * d, H * d): Q, one eigenvector a column.
        spread (H * d,): Standard deviations along them.
        mean_low, mean_high (H * d,): Range of m(c) over the training windows, with a margin. The features of a motion
            are collinear: off their manifold, inside the box of the training observations, the regression could
            extrapolate by more than all that it was fitted to.
    """

    slope: Tensor
    offset: Tensor
    basis: Tensor
    spread: Tensor
    mean_low: Tensor
    mean_high: Tensor

    def __init__(self, observation_dim: int, chunk_dim: int):
        super().__init__()
        self.register_buffer("slope", torch.zeros(observation_dim, chunk_dim))
        self.register_buffer("offset", torch.zeros(chunk_dim))
        self.register_buffer("basis", torch.eye(chunk_dim))
        self.register_buffer("spread", torch.ones(chunk_dim))
        self.register_buffer("mean_low", torch.full((chunk_dim,), -torch.inf))
        self.register_buffer("mean_high", torch.full((chunk_dim,), torch.inf))

    @torch.no_grad()
    def fit(self, observation: Tensor, chunk: Tensor, noise: float = 0.0) -> ChunkFrame:
        """Fit to the training windows.

        Args:
            observation: Preprocessed observations (N, C).
            chunk: Flattened normalised chunks (N, H * d).
            noise: Standard deviation of the noise that observations will have in training; a regression on noisy
                inputs is a ridge regression.
        """
        observation, chunk = observation.double(), chunk.double()
        centre, middle = observation.mean(dim=0), chunk.mean(dim=0)
        inputs, outputs = observation - centre, chunk - middle
        n = len(inputs)
        ridge = max(RIDGE, noise**2)
        gram = inputs.T @ inputs / n + ridge * torch.eye(inputs.shape[1], dtype=inputs.dtype, device=inputs.device)
        slope = torch.linalg.solve(gram, inputs.T @ outputs / n)
        residual = outputs - inputs @ slope
        variance, basis = torch.linalg.eigh(residual.T @ residual / n + noise**2 * slope.T @ slope)
        self.slope.copy_(slope)
        self.offset.copy_(middle - centre @ slope)
        self.basis.copy_(basis)
        self.spread.copy_(variance.clamp(min=0).sqrt())
        mean = inputs @ slope + middle
        low, high = mean.amin(dim=0), mean.amax(dim=0)
        self.mean_low.copy_(low - MEAN_MARGIN * (high - low))
        self.mean_high.copy_(high + MEAN_MARGIN * (high - low))
        return self

    def mean(self, observation: Tensor) -> Tensor:
        """m(c): normalised chunks (B, H * d) for preprocessed observations (B, C)."""
        return (observation @ self.slope + self.offset).clamp(self.mean_low, self.mean_high)

    def enter(self, chunk: Tensor, observation: Tensor) -> Tensor:
        """y_1 of flattened normalised chunks (B, H * d)."""
        return (chunk - self.mean(observation)) @ self.basis

    def rotate(self, noise: Tensor) -> Tensor:
        """y_0 of source noise (..., H * d)."""
        return noise @ self.basis

    def leave(self, value: Tensor, observation: Tensor) -> Tensor:
        """Flattened normalised chunks of y_1 (B, ..., H * d), with observations (B, C)."""
        mean = self.mean(observation)
        return value @ self.basis.T + mean.reshape(len(mean), *[1] * (value.ndim - 2), -1)
