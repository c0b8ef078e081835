"""The joint law of both heads' clean chunks under one condition: two Gaussian modes with one covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TwoModePair:
    """Clean chunks (X_A, X_B) of both heads, and what couples their source noise, in the units of the flow loss.

    Everything is centred on the point half-way between the modes, so that mode s = -1 or +1 has means s * half_a and
    s * half_b, and the kinematics are the matrix G with G half_a = half_b and no offset.

    Attributes:
        half_a, half_b: Half of the difference between the modes' means, (n_A,) and (n_B,).
        kinematics: G (n_B, n_A).
        covariance_a, covariance_b: Covariances within a mode, (n_A, n_A) and (n_B, n_B).
        covariance_ab: Covariance of X_A with X_B within a mode (n_A, n_B).
        noise_ab: Covariance of the heads' standard normal source noise (n_A, n_B).
        log_odds: log P(s = +1) / P(s = -1).
        loss_ratio: Weight of head A's flow loss against head B's per squared unit: n_B / n_A of the whole chunks,
            since each loss is a mean over coordinates.
    """

    half_a: np.ndarray
    half_b: np.ndarray
    kinematics: np.ndarray
    covariance_a: np.ndarray
    covariance_b: np.ndarray
    covariance_ab: np.ndarray
    noise_ab: np.ndarray
    log_odds: float = 0.0
    loss_ratio: float = 1.0

    def at_time(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Covariances within a mode of (x_t^A, x_t^A), (x_t^B, x_t^B) and (x_t^A, x_t^B)."""
        noise, data = (1 - time) ** 2, time**2
        return (
            noise * np.eye(len(self.half_a)) + data * self.covariance_a,
            noise * np.eye(len(self.half_b)) + data * self.covariance_b,
            noise * self.noise_ab + data * self.covariance_ab,
        )
