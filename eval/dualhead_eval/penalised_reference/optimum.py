r"""The population optimum of the training loss with endpoint consistency (eq:cons), at one time.

The loss sums, over uniform times t, the heads' flow losses (eq:cfm; a mean over each chunk's n_A or n_B coordinates)
and lambda times the mean squared distance of the clean endpoints a = x_t + (1 - t) v through the kinematics G, all in
the units of head B's flow loss. With x_1 = x_t + (1 - t) (x_1 - x_0) a velocity's error is its endpoint's error,
v - (x_1 - x_0) = (a - x_1) / (1 - t), and every time is minimised by itself:

    E |a_A - X_A|^2 / (n_A (1-t)^2) + E |a_B - X_B|^2 / (n_B (1-t)^2) + lambda E |G a_A - a_B|^2 / n_B

or, times n_B (1-t)^2, with r = n_B / n_A and w = lambda (1-t)^2,

    r E |a_A - X_A|^2 + E |a_B - X_B|^2 + w E |G a_A - a_B|^2.                                              (1)

a_A is a function of x_t^A and a_B of x_t^B (and the condition). With P_A and P_B, the conditional expectations given
x_t^A and x_t^B, and m_A = P_A X_A and m_B = P_B X_B, the optimum of the flow losses alone, the minimum is where

    (r + w G^T G) a_A = r m_A + w G^T P_A a_B,        (1 + w) a_B = m_B + w G P_B a_A.                      (2)

Alternating these two contracts. Three consequences: at t -> 1 consistency vanishes (w -> 0); at t = 0 nothing is known
of the mode and the optimum is the mean, as without it; in between each head moves from its own posterior mean towards
what it expects of the other's, so that it uses what it sees of the noise that they share.

For two Gaussian modes s = -1, +1 with one covariance, m = K x_t + (1 - t K) half E[s | x_t], and (2) splits into a
linear part and one that depends on the mode, a = L x_t + f. With regressions Gamma_A = S_AB S_B^(-1) of x_t^A on x_t^B
within a mode and Gamma_B the other way round,

    (1 + w) L_B = K_B + w G L_A Gamma_A,              (r + w G^T G) L_A = r K_A + w G^T L_B Gamma_B,
    (1 + w) f_B = b E[s | x_t^B] + w G P_B f_A,       b = (1 - t K_B) half_B + w t G L_A (half_A - Gamma_A half_B),
    (r + w G^T G) f_A = c E[s | x_t^A] + w G^T P_A f_B,
                                                      c = r (1 - t K_A) half_A + w t G^T L_B (half_B - Gamma_B half_A).

In the singular vectors of G every coordinate is a problem of its own, with a singular value sigma. Eliminating f_B,
the table gamma = E[f_A | u, s] of :mod:`dualhead_eval.penalised_reference.conditional_expectation` obeys

    (1 - q P) gamma = (c E[s | x_t^A] + w sigma b E[s | x_t^B] / (1 + w)) / (r + w sigma^2),   averaged given (u, s),
    q = w^2 sigma^2 / ((1 + w) (r + w sigma^2)) < 1,

where P = P_B P_A averages: the fixed-point iteration gains a factor q a step.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from dualhead_eval.penalised_reference.conditional_expectation import NEGLIGIBLE, SIGNS, Resolution, TimeSlice
from dualhead_eval.penalised_reference.two_mode_pair import TwoModePair

#: Bound on what the iteration leaves, in units of the modes' half difference, and iterations at most.
TOLERANCE = 1e-7
MAX_ITERATIONS = 2_000


class PenalisedOptimum:
    """Clean endpoints of both heads at the optimum, at one time; see the module.

    Args:
        pair: The joint law of the clean chunks.
        time: t in [0, 1).
        consistency_weight: lambda, at least 0.
        resolution: Of the tables.

    Raises:
        RuntimeError: If the iteration does not settle.
    """

    def __init__(
        self,
        pair: TwoModePair,
        time: float,
        consistency_weight: float,
        resolution: Resolution | None = None,
    ):
        self.pair = pair
        self.slice = TimeSlice(pair, time, resolution or Resolution())
        self.weight = consistency_weight * (1 - time) ** 2
        self.linear_a, self.linear_b = linear_part(pair, time, consistency_weight)
        w, r, g = self.weight, pair.loss_ratio, pair.kinematics
        to_a, to_b = self.slice.regression_a, self.slice.regression_b
        gain_a, gain_b = _gains(pair, time)
        b = pair.half_b - time * gain_b @ pair.half_b
        b += w * time * g @ self.linear_a @ (pair.half_a - to_a @ pair.half_b)
        c = r * (pair.half_a - time * gain_a @ pair.half_a)
        c += w * time * g.T @ self.linear_b @ (pair.half_b - to_b @ pair.half_a)
        # Singular vectors of G; what head A can do without moving head B's point has the singular value 0.
        self.left, self.sigma, right = np.linalg.svd(g, full_matrices=True)
        self.right = right.T
        n = len(self.sigma)
        self.b, self.c, self.ratio = self.left.T @ b, self.right.T @ c, r
        self.denominator = r + w * self.sigma**2
        mean_a, mean_b = self.slice.posterior_means
        source = mean_a[:, None] * self.c[:n] + w * self.sigma / (1 + w) * mean_b[:, None] * self.b[:n]
        self.contraction = w**2 * self.sigma**2 / ((1 + w) * self.denominator)
        scale = max(float(np.abs(pair.half_a).max()), 1e-12)
        self.tables = np.zeros(source.shape)
        if w > 0 and source.any():
            # Directions in which the modes do not differ have no source, and nothing to solve.
            some = np.abs(source).max(axis=0) > max(1e-9 * np.abs(source).max(), 1e-300)
            self.tables[:, some] = solve_contraction(
                self.slice.operator, (source / self.denominator)[:, some], self.contraction[some], scale
            )

    def endpoint_b(self, x: np.ndarray) -> np.ndarray:
        """a_B (P, n_B) at centred noisy chunks x_t^B (P, n_B)."""
        u = x @ (self.slice.coordinates @ self.slice.whiten_b).T
        return x @ self.linear_b.T + self._values_b(u) @ self.left[:, : len(self.sigma)].T

    def endpoint_a(self, x: np.ndarray) -> np.ndarray:
        """a_A (P, n_A) at centred noisy chunks x_t^A (P, n_A)."""
        white = x @ self.slice.whiten_a.T
        values = self.slice.sign_given_a(white)[:, None] * self.c
        n = len(self.sigma)
        if self.weight > 0:
            values[:, :n] += self.weight * self.sigma * self._expected_values_b(white)
        values[:, :n] /= self.denominator
        values[:, n:] /= self.ratio
        return x @ self.linear_a.T + values @ self.right.T

    def expected_b(self, x: np.ndarray) -> np.ndarray:
        """What head A expects of head B's endpoint, P_A a_B (P, n_B), at centred noisy chunks x_t^A (P, n_A)."""
        white = x @ self.slice.whiten_a.T
        sign = self.slice.sign_given_a(white)[:, None]
        noisy = x @ self.slice.regression_b.T
        noisy += sign * (self.slice.time * (self.pair.half_b - self.slice.regression_b @ self.pair.half_a))
        return noisy @ self.linear_b.T + self._expected_values_b(white) @ self.left[:, : len(self.sigma)].T

    def _expected_values_b(self, white: np.ndarray) -> np.ndarray:
        """P_A f_B (P, n) in the left singular vectors of G, at whitened chunks of head A."""
        expected = self.slice.sign_given_a(white)
        nodes, weights = self.slice.spread_of_u()
        values = np.zeros((len(white), len(self.sigma)))
        for sign in SIGNS:
            share = (1 + sign * expected) / 2
            rows = np.flatnonzero(share > NEGLIGIBLE)
            centre = self.slice.mean_u(white[rows], sign)
            for node, weight in zip(nodes, weights, strict=True):
                values[rows] += weight * share[rows, None] * self._values_b(centre + node)
        return values

    def _values_b(self, u: np.ndarray) -> np.ndarray:
        """f_B (P, n) in the left singular vectors of G."""
        own = self.slice.sign_given_u(u)[:, None] * self.b[: len(self.sigma)]
        if self.weight == 0:
            return own
        return (own + self.weight * self.sigma * self.slice.given_u(self.tables, u)) / (1 + self.weight)


def linear_part(pair: TwoModePair, time: float, consistency_weight: float) -> tuple[np.ndarray, np.ndarray]:
    """L_A (n_A, n_A) and L_B (n_B, n_B): how the endpoints follow the noisy chunks within a mode."""
    w, r = consistency_weight * (1 - time) ** 2, pair.loss_ratio
    gain_a, gain_b = _gains(pair, time)
    if not gain_a.any() and not gain_b.any():
        return gain_a, gain_b
    s_a, s_b, s_ab = pair.at_time(time)
    to_a, to_b = np.linalg.solve(s_b, s_ab.T).T, np.linalg.solve(s_a, s_ab).T
    left, sigma, right = np.linalg.svd(pair.kinematics, full_matrices=True)
    n = len(sigma)
    own_a, own_b = right @ gain_a, left.T @ gain_b
    denominator = r + w * sigma**2
    # l_B ((1 + w) - w^2 sigma^2 / (r + w sigma^2) Gamma_B Gamma_A) = k_B + w sigma r / (r + w sigma^2) k_A Gamma_A
    source = own_b[:n] + (w * sigma * r / denominator)[:, None] * (own_a[:n] @ to_a)
    system = (1 + w) * np.eye(len(gain_b)) - (w**2 * sigma**2 / denominator)[:, None, None] * (to_b @ to_a)
    rows_b = np.linalg.solve(system.transpose(0, 2, 1), source[..., None])[..., 0]
    rows_a = own_a.copy()
    rows_a[:n] = (r * own_a[:n] + (w * sigma)[:, None] * (rows_b @ to_b)) / denominator[:, None]
    return right.T @ rows_a, left[:, :n] @ rows_b


def _gains(pair: TwoModePair, time: float) -> tuple[np.ndarray, np.ndarray]:
    """K_A and K_B: within a mode, E[X | x_t] = mean + K (x_t - t mean)."""
    s_a, s_b, _ = pair.at_time(time)
    return (
        np.linalg.solve(s_a, time * pair.covariance_a).T,
        np.linalg.solve(s_b, time * pair.covariance_b).T,
    )


def solve_contraction(
    operator: sparse.csr_matrix, source: np.ndarray, contraction: np.ndarray, scale: float
) -> np.ndarray:
    """The solution (N, c) of (1 - q P) y = source for every column's q, by fixed-point iteration.

    Args:
        operator: P (N, N), of spectral radius 1.
        source: (N, c).
        contraction: q (c,), each in [0, 1).
        scale: What the tolerance is measured in.

    Raises:
        RuntimeError: If it has not settled after ``MAX_ITERATIONS``.
    """
    solution = source
    for _ in range(MAX_ITERATIONS):
        following = source + contraction * (operator @ solution)
        change = np.abs(following - solution).max(axis=0) / (1 - contraction)
        solution = following
        if change.max() < TOLERANCE * scale:
            return solution
    raise RuntimeError(
        f"the penalised optimum has not settled after {MAX_ITERATIONS} iterations: expected an error below "
        f"{TOLERANCE * scale:.1e}; lower consistency_weight"
    )
