"""What each head knows of the other at one time: conditional expectations on the coordinates that decide the mode.

Within mode s the whitened noisy chunks a = S_A^(-1/2) x_t^A and b = S_B^(-1/2) x_t^B are standard normal around s m_A
and s m_B, and correlate by R = S_A^(-1/2) S_AB S_B^(-T/2). Expectations of functions of the mode given b depend on
few coordinates u = C b: the direction m_B that tells the modes apart in head B, the direction R^T m_A in which head B
sees what tells them apart in head A, and their images under R^T R. C holds the first of these, orthonormalised; on the
ring and for modes without width the list ends after one or two, and nothing is left out.

Functions of u are tabulated on one grid around each mode, and what is sharp in them, the posterior over modes, is kept
analytic. Head A needs no grid, whatever the size of its space.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import linalg, sparse

from dualhead_eval.penalised_reference.two_mode_pair import TwoModePair

#: Modes, in the order of every table.
SIGNS = (-1, 1)
#: Standard deviations around a mode that a grid covers.
HALF_WIDTH = 6.5
#: Coordinates of head B that are kept at most.
MAX_COORDINATES = 2
#: Entries of an operator, and nodes of a quadrature, below this weight are left out.
NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class Resolution:
    """How finely functions are tabulated and integrated.

    Attributes:
        spacing: Distance between grid points in standard deviations.
        nodes: Gauss-Hermite nodes per dimension.
    """

    spacing: float = 0.7
    nodes: int = 5


class Grid:
    """A uniform grid in q coordinates around the origin, with cubic interpolation."""

    def __init__(self, dimensions: int, spacing: float):
        self.n = 2 * int(np.ceil(HALF_WIDTH / spacing)) + 1
        self.step = 2 * HALF_WIDTH / (self.n - 1)
        axis = np.linspace(-HALF_WIDTH, HALF_WIDTH, self.n)
        self.points = np.stack(np.meshgrid(*[axis] * dimensions, indexing="ij"), -1).reshape(-1, dimensions)

    def interpolation(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Indices and weights (P, 4^q) of the grid points that give a function's values at ``points`` (P, q).

        Four-point Lagrange polynomials in every coordinate; a point outside takes the value at the border.
        """
        place = (np.clip(points, -HALF_WIDTH, HALF_WIDTH) + HALF_WIDTH) / self.step
        low = np.clip(place.astype(int) - 1, 0, self.n - 4)
        x = place - low
        weights = np.stack(
            [
                -(x - 1) * (x - 2) * (x - 3) / 6,
                x * (x - 2) * (x - 3) / 2,
                -x * (x - 1) * (x - 3) / 2,
                x * (x - 1) * (x - 2) / 6,
            ],
            axis=-1,
        )
        index, weight = np.zeros((len(points), 1), dtype=np.int64), np.ones((len(points), 1))
        for axis in range(points.shape[1]):
            corner = low[:, axis, None] + np.arange(4)
            index = (index[:, :, None] * self.n + corner[:, None, :]).reshape(len(points), 4 ** (axis + 1))
            weight = (weight[:, :, None] * weights[:, axis][:, None, :]).reshape(len(points), 4 ** (axis + 1))
        return index, weight


class TimeSlice:
    """Both heads at one time t; see the module.

    Args:
        pair: The joint law of the clean chunks.
        time: t in [0, 1).
        resolution: Of grids and quadratures.

    Attributes:
        regression_a: S_AB S_B^(-1) (n_A, n_B): within a mode, how x_t^A follows x_t^B.
        regression_b: S_BA S_A^(-1) (n_B, n_A): the other way round.
        left_out: Largest correlation of what decides the mode with coordinates of head B that were not kept; 0 where
            nothing was left out.
        posterior_means: E[sign | x_t^A] averaged given u, and E[sign | x_t^B] averaged over what head A knows and then
            given u: two vectors (2 G,), mode by mode, at the grid's G points.
        operator: The tables (2 G,) of gamma_s(u) = E[f_A | u, s] to those of E[E[f_B | x_t^A] | u, s] where f_B is the
            posterior mean of gamma_s: P_B P_A, a sparse matrix (2 G, 2 G).
    """

    def __init__(self, pair: TwoModePair, time: float, resolution: Resolution):
        self.time = time
        self.half_log_odds = pair.log_odds / 2
        s_a, s_b, s_ab = pair.at_time(time)
        root_a, root_b = np.linalg.cholesky(s_a), np.linalg.cholesky(s_b)
        self.whiten_a = linalg.solve_triangular(root_a, np.eye(len(s_a)), lower=True)
        self.whiten_b = linalg.solve_triangular(root_b, np.eye(len(s_b)), lower=True)
        cross = self.whiten_a @ s_ab @ self.whiten_b.T
        self.regression_a = root_a @ cross @ self.whiten_b
        self.regression_b = root_b @ cross.T @ self.whiten_a
        # Directions are those of the modes' difference at any time; at t = 0 its length is 0.
        towards_a, towards_b = self.whiten_a @ pair.half_a, self.whiten_b @ pair.half_b
        self.mean_a, self.mean_b = time * towards_a, time * towards_b
        self.coordinates, self.left_out = _deciding_coordinates(towards_a, towards_b, cross)
        self.grid = Grid(len(self.coordinates), resolution.spacing)
        self.nodes = resolution.nodes
        self.u_mean = self.coordinates @ self.mean_b
        self._cross_u = self.coordinates @ cross.T  # C R^T, (q, n_A)
        self._spread = np.eye(len(self.coordinates)) - self._cross_u @ self._cross_u.T
        self.operator, self.posterior_means = self._project()

    # --- posterior means of the mode ---------------------------------------------------------------------------

    def sign_given_a(self, white: np.ndarray) -> np.ndarray:
        """E[s | x_t^A] (P,) at whitened chunks (P, n_A)."""
        return np.tanh(self.half_log_odds + white @ self.mean_a)

    def sign_given_u(self, u: np.ndarray) -> np.ndarray:
        """E[s | x_t^B] (P,) at u (P, q)."""
        return np.tanh(self.half_log_odds + u @ self.u_mean)

    # --- functions of head B, seen by both heads ---------------------------------------------------------------

    def given_u(self, tables: np.ndarray, u: np.ndarray) -> np.ndarray:
        """E[f_A | x_t^B] (P, c) at u (P, q), from the tables gamma (2 G, c)."""
        return self._mixture_matrix(u) @ tables

    def mean_u(self, white: np.ndarray, sign: int) -> np.ndarray:
        """E[u | x_t^A, s] (P, q) at whitened chunks (P, n_A)."""
        return sign * self.u_mean + (white - sign * self.mean_a) @ self._cross_u.T

    def spread_of_u(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (M, q) and weights (M,) of u around its mean given x_t^A and s."""
        return _gaussian_nodes(self._spread, self.nodes)

    def _mixture_matrix(self, u: np.ndarray) -> sparse.csr_matrix:
        """Posterior-weighted interpolation in both modes' grids, (P, 2 G)."""
        rows, columns, values = self._mixture_entries(u, np.ones(len(u)), np.arange(len(u)))
        size = 2 * len(self.grid.points)
        return sparse.csr_matrix((values, (rows, columns)), shape=(len(u), size))

    def _mixture_entries(
        self, u: np.ndarray, weight: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows, columns, values = [], [], []
        expected = self.sign_given_u(u)
        for block, sign in enumerate(SIGNS):
            share = weight * (1 + sign * expected) / 2
            keep = share > NEGLIGIBLE
            index, interpolation = self.grid.interpolation(u[keep] - sign * self.u_mean)
            rows.append(np.repeat(row[keep], index.shape[1]))
            columns.append((index + block * len(self.grid.points)).ravel())
            values.append((interpolation * share[keep, None]).ravel())
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)

    def _project(self) -> tuple[sparse.csr_matrix, tuple[np.ndarray, np.ndarray]]:
        """P_B P_A on tables, and its action on the posterior means.

        Given u and the true mode s, x_t^A is Gaussian; head A weighs mode j by its posterior and then expects
        u' = mean_u(x_t^A, j) + spread. The half log-odds l of head A and u' are jointly Gaussian given (u, s, j): an
        outer quadrature over u', and the expectation of tanh(l) given u' from a table in its mean.
        """
        local, n = self.grid.points, len(self.grid.points)
        unknown = np.eye(len(self.mean_a)) - self._cross_u.T @ self._cross_u
        square = self._cross_u @ self._cross_u.T  # C R^T R C^T
        covariance = np.eye(len(square)) - square @ square
        variance = float(self.mean_a @ unknown @ self.mean_a)
        shared = self._cross_u @ unknown @ self.mean_a
        nodes, node_weights = _gaussian_nodes(covariance, self.nodes)
        gain = np.linalg.pinv(covariance, rcond=1e-9, hermitian=True) @ shared
        rest = max(variance - float(shared @ gain), 0.0)
        first = np.zeros(2 * n)
        second = np.zeros(2 * n)
        entries = []
        for block, sign in enumerate(SIGNS):
            rows = block * n + np.arange(n)
            level = self.half_log_odds + sign * self.mean_a @ self.mean_a + local @ (self._cross_u @ self.mean_a)
            first[rows] = _mean_tanh(level, variance)
            for guess in SIGNS:
                centre = guess * self.u_mean + (sign - guess) * (self._cross_u @ self.mean_a) + local @ square
                u = (centre[:, None] + nodes).reshape(-1, local.shape[1])
                expected = _mean_tanh((level[:, None] + nodes @ gain).ravel(), rest)
                weight = np.tile(node_weights, n) * (1 + guess * expected) / 2
                row = np.repeat(rows, len(nodes))
                second += np.bincount(row, weights=weight * self.sign_given_u(u), minlength=2 * n)
                keep = weight > NEGLIGIBLE
                entries.append(self._mixture_entries(u[keep], weight[keep], row[keep]))
        row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        return sparse.csr_matrix((value, (row, column)), shape=(2 * n, 2 * n)), (first, second)


def _deciding_coordinates(towards_a: np.ndarray, towards_b: np.ndarray, cross: np.ndarray) -> tuple[np.ndarray, float]:
    """C (q, n_B) with orthonormal rows, and the largest norm of what it leaves out of the next images."""
    found: list[np.ndarray] = []
    pending = [towards_b / max(np.linalg.norm(towards_b), 1e-300)]
    pending.append(cross.T @ (towards_a / max(np.linalg.norm(towards_a), 1e-300)))
    left_out = 0.0
    while pending:
        vector = pending.pop(0)
        for _ in range(2):  # twice, against round-off
            for direction in found:
                vector = vector - direction * (direction @ vector)
        length = float(np.linalg.norm(vector))
        if length < 1e-6:
            continue
        if len(found) == MAX_COORDINATES:
            left_out = max(left_out, length)
            continue
        found.append(vector / length)
        pending.append(cross.T @ (cross @ found[-1]))
    return np.array(found).reshape(len(found), len(towards_b)), left_out


def _gaussian_nodes(covariance: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Hermite nodes (M, q) and weights (M,) of N(0, covariance); one node along what does not vary."""
    variance, basis = np.linalg.eigh((covariance + covariance.T) / 2)
    one, weight = np.polynomial.hermite_e.hermegauss(nodes)
    weight = weight / weight.sum()
    axes = [(one * v**0.5, weight) if v > 1e-10 else (np.zeros(1), np.ones(1)) for v in variance]
    points = np.array(list(product(*[axis for axis, _ in axes]))) @ basis.T
    weights = np.prod(np.array(list(product(*[w for _, w in axes]))), axis=1)
    keep = weights > NEGLIGIBLE
    return points[keep], weights[keep] / weights[keep].sum()


def _mean_tanh(mean: np.ndarray, variance: float) -> np.ndarray:
    """E tanh(N(mean, variance)), from a table in the mean."""
    if variance < 1e-12:
        return np.tanh(mean)
    one, weight = np.polynomial.hermite_e.hermegauss(41)
    low, high = float(mean.min()), float(mean.max())
    table = np.linspace(low, high, max(2, min(4001, int(np.ceil((high - low) / 0.01)) + 2)))
    values = np.tanh(table[:, None] + variance**0.5 * one) @ (weight / weight.sum())
    return np.interp(mean, table, values)
