"""The population-optimal flow-matching sampler of the ring, in closed form.

On the ring every mode's path is Gaussian, so the target of each head is a K-component Gaussian mixture with one
shared covariance, in head A's space too when the representation map is linear. The velocity that minimises the
flow-matching loss over all functions, E[x_1 - x_0 | x_t, c], is then posterior mode weights times per-mode
linear-Gaussian conditional means. What a trained policy is held against is thus not another network but the
optimum that it approximates, integrated with the same number of Euler steps.

For ``polar`` each mode is replaced by the Gaussian with its mean and covariance in head A's space; the result is
an approximation and says so. There is no reference for k-means tokens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.ring import geometry
from dualhead_envs.ring.generator import RingGenerator, envelope
from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap, RepresentationMap
from dualhead_policy.flow.coupling import resolve_shared_draws, resolve_source_noise
from dualhead_policy.flow.flow_matching import integrate_euler
from dualhead_policy.sampling import HeadSamples, SamplingCoupling

#: Radii at which the moments of the polar representation are estimated; linear interpolation in between.
MOMENT_RADII = 25
#: Paths per radius for those moments: the standard error of a covariance entry is below 1 % of its variance.
MOMENT_PATHS = 16_384


class ExactReference:
    """Samples both heads of the population-optimal policy of a ring (the policy's own sampling interface).

    Args:
        n_modes: K.
        representation: ``"orthogonal"``, ``"nullspace"`` (exact) or ``"polar"`` (approximate).
        mode_probabilities: Prior over modes; None: uniform.
        mode_angles: Offsets of the modes from theta in radians; None: equal spacing.
        path_spread: Standard deviation of delta in metres.
        source_noise_beta: Coupling of the heads' source noise when the caller does not choose one.
        token: None, or ``"oracle"``.
        token_replacement_prob: Probability of a uniformly random token during (hypothetical) training.
        token_draw: ``"uniform"`` or ``"marginal"`` draw of tokens at sampling, or the probability of each token.

    Raises:
        ValueError: If an argument is outside its range, or the token has no reference.
    """

    def __init__(
        self,
        n_modes: int,
        representation: str,
        *,
        mode_probabilities: list[float] | None = None,
        mode_angles: list[float] | None = None,
        path_spread: float = geometry.PATH_SPREAD,
        source_noise_beta: float = 1.0,
        token: str | None = None,
        token_replacement_prob: float = 0.0,
        token_draw: str | Sequence[float] = "uniform",
    ):
        if representation not in REPRESENTATION_MAPS:
            raise ValueError(
                f"representation={representation!r} is not one of {sorted(REPRESENTATION_MAPS)}: choose one of these"
            )
        if token not in (None, "oracle"):
            raise ValueError(
                f"token={token!r} has no exact reference: use no token or 'oracle' (k-means tokens are judged by "
                "valid-pair rate and rho alone)"
            )
        if not 0 <= token_replacement_prob <= 1 or not 0 <= source_noise_beta <= 1:
            raise ValueError(
                f"token_replacement_prob={token_replacement_prob} and source_noise_beta={source_noise_beta} must "
                "lie in [0, 1]"
            )
        if not isinstance(token_draw, str):
            weights = np.asarray(token_draw, dtype=np.float64)
            if weights.shape != (n_modes,) or not (weights >= 0).all() or abs(weights.sum() - 1) > 1e-6:
                raise ValueError(
                    f"token_draw={token_draw!r} should be {n_modes} non-negative numbers that sum to 1, one per token"
                )
        self.generator = RingGenerator(n_modes, mode_probabilities, mode_angles, path_spread)
        self.map = REPRESENTATION_MAPS[representation]
        self.exact = isinstance(self.map, LinearMap)
        self.source_noise_beta = source_noise_beta
        self.token = token
        self.token_replacement_prob = token_replacement_prob
        self.token_draw = token_draw
        self.head_dims = {"joint": self.map.width, "position": 2}

    @property
    def kinematic_map(self) -> str:
        """Name of the map from head A's space to the position."""
        return f"ring/{self.map.name}"

    def describe(self) -> dict[str, Any]:
        """Provenance: what this sampler is."""
        return {
            "method": "exact reference" if self.exact else "moment-matched reference (approximate)",
            "kinematic_map": self.kinematic_map,
            "n_modes": self.generator.n_modes,
            "mode_probabilities": list(self.generator.probabilities),
            "path_spread": self.generator.path_spread,
            "source_noise_beta": self.source_noise_beta,
            "token": self.token,
            "token_replacement_prob": self.token_replacement_prob,
            "token_draw": self.token_draw if isinstance(self.token_draw, str) else list(self.token_draw),
        }

    @torch.no_grad()
    def sample(
        self,
        batch: Mapping[str, Tensor],
        num_samples: int,
        *,
        num_steps: int | None = None,
        coupling: SamplingCoupling | None = None,
        generator: torch.Generator | None = None,
    ) -> HeadSamples:
        """Sample as ``DualheadPolicy.sample`` does; ``batch`` holds raw observations (B, dim)."""
        coupling = coupling or SamplingCoupling()
        num_steps = num_steps or 20
        condition = batch["observation.environment_state"].double().numpy()
        leading = (len(condition), num_samples)
        shape = (*leading, geometry.HORIZON)
        draw = coupling.token_draw or self.token_draw
        # A linear map's columns are orthonormal: they are their own polar factor.
        carry = torch.from_numpy(self.map.matrix).float() if isinstance(self.map, LinearMap) else None
        alignment = None if carry is None else lambda: {"position": carry}
        source = resolve_source_noise(
            coupling, shape, self.head_dims, self.source_noise_beta, generator, alignment=alignment
        )
        shared = resolve_shared_draws(
            coupling,
            list(self.head_dims),
            None if self.token is None else lambda: self._draw_tokens(leading, draw, generator),
            None,
        )
        target = torch.from_numpy(
            geometry.mode_directions(condition, self.generator.angles) * condition[:, 2, None, None]
        ).float()
        heads = {}
        for head, noise in source.items():
            log_prior = self._log_prior(shared[head].token)
            if head == "joint" and not self.exact:
                heads[head] = self._integrate_matched(noise, condition, log_prior, num_steps)
            else:
                matrix = torch.eye(2)
                if head == "joint" and isinstance(self.map, LinearMap):
                    matrix = torch.from_numpy(self.map.matrix).float()
                heads[head] = self._integrate_linear(noise, target, matrix, log_prior, num_steps)
        return HeadSamples(heads["joint"], heads["position"], token=shared["joint"].token)

    def _draw_tokens(
        self, leading: tuple[int, int], draw: str | Sequence[float], generator: torch.Generator | None
    ) -> Tensor:
        weights = torch.ones(self.generator.n_modes)
        if draw == "learned":
            raise ValueError("the exact reference learns no prior of its tokens: draw them uniform or marginal")
        if draw == "marginal":
            weights = torch.tensor(self.generator.probabilities, dtype=torch.float32)
        elif not isinstance(draw, str):
            weights = torch.tensor(draw, dtype=torch.float32)
        count = leading[0] * leading[1]
        return torch.multinomial(weights, count, replacement=True, generator=generator).reshape(leading)

    def mode_given_token(self) -> Tensor:
        """P(mode | token) (K, K), a row per token.

        With replacement probability p, P(k | z) is proportional to pi_k ((1 - p) [k = z] + p / K).
        """
        k, p = self.generator.n_modes, self.token_replacement_prob
        prior = torch.tensor(self.generator.probabilities, dtype=torch.float32)
        table = prior * ((1 - p) * torch.eye(k) + p / k)
        return table / table.sum(1, keepdim=True)

    def _log_prior(self, token: Tensor | None) -> Tensor:
        """log P(mode | token): (K,) without a token, (B, N, K) with one."""
        if token is None:
            return torch.tensor(self.generator.probabilities, dtype=torch.float32).log()
        return self.mode_given_token().log()[token]

    def _integrate_linear(
        self, noise: Tensor, target: Tensor, matrix: Tensor, log_prior: Tensor, num_steps: int
    ) -> Tensor:
        """Euler integration of the optimal field where head = matrix @ position, matrix^T matrix = I.

        The covariance of every mode has two eigenvalues: one along the envelope s (in both coordinates), one
        across it. Across the envelope and outside the column space of the matrix, the field is a scalar times
        x, so those parts only shrink by a known factor; the mode depends on a 2-D projection of the noise.

        Args:
            noise: x_0 (B, N, H, d).
            target: r u_k for every mode (B, K, 2).
            matrix: (d, 2).
            log_prior: (K,) or (B, N, K).
            num_steps: Euler steps.
        """
        s = torch.from_numpy(envelope()).float()
        length = s.norm()
        unit = s / length
        point = geometry.POINT_NOISE**2
        along_variance = self.generator.path_spread**2 * float(length) ** 2 + point
        position = noise @ matrix
        outside = noise - position @ matrix.T
        along = torch.einsum("bnhd,h->bnd", position, unit)
        across = position - unit[:, None] * along[..., None, :]
        means = length * target

        def velocity(x: Tensor, time: float) -> Tensor:
            variance = (1 - time) ** 2 + time**2 * along_variance
            distance = (x[..., None, :] - time * means[:, None]).square().sum(-1)
            weight = torch.softmax(log_prior - distance / (2 * variance), dim=-1)
            mean = torch.einsum("bnk,bkd->bnd", weight, means)
            return mean + (time * along_variance - (1 - time)) / variance * (x - time * mean)

        certain = (log_prior == 0).nonzero()
        if log_prior.ndim == 1 and len(certain):  # one Gaussian: Euler's steps are a factor about its mean
            along = means[:, certain[0]] + along * _shrinkage(along_variance, num_steps)
        else:
            along = integrate_euler(velocity, along, num_steps)
        across = across * _shrinkage(point, num_steps)
        outside = outside * _shrinkage(0.0, num_steps)
        position = unit[:, None] * along[..., None, :] + across
        return position @ matrix.T + outside

    def _integrate_matched(self, noise: Tensor, condition: np.ndarray, log_prior: Tensor, num_steps: int) -> Tensor:
        """Euler integration with each mode moment-matched in head A's space (the polar representation).

        The map commutes with rotations about the origin, so one set of moments, at mode angle 0 and the
        condition's radius, serves every mode after a rotation.
        """
        mean, covariance = _moments_at(self.map, self.generator.path_spread, condition[:, 2])
        eigenvalues, basis = (part.float() for part in torch.linalg.eigh(covariance))
        n, k = len(condition), self.generator.n_modes
        theta = np.arctan2(condition[:, 1], condition[:, 0])
        angle = torch.from_numpy(theta[:, None] + np.asarray(self.generator.angles)).float()
        cos, sin = angle.cos(), angle.sin()
        rotation = torch.stack([torch.stack([cos, -sin], -1), torch.stack([sin, cos], -1)], -2)
        # Rows: flattened head-A chunks; columns: coordinates in the eigenbasis of mode k's covariance.
        frame = torch.einsum("bkij,bhjm->bkhim", rotation, basis.reshape(n, -1, 2, basis.shape[-1]))
        frame = frame.reshape(n, k, -1, basis.shape[-1])
        center = torch.einsum("bhm,bh->bm", basis, mean.float())[:, None, None]
        spread = eigenvalues.clamp_min(1e-12)[:, None, None]

        def velocity(x: Tensor, time: float) -> Tensor:
            variance = (1 - time) ** 2 + time**2 * spread
            local = torch.einsum("bnf,bkfm->bnkm", x, frame) - time * center
            distance = (local.square() / variance).sum(-1)
            weight = torch.softmax(log_prior - distance / 2, dim=-1)
            moved = center + (time * spread - (1 - time)) / variance * local
            return torch.einsum("bnkm,bkfm->bnf", weight[..., None] * moved, frame)

        return integrate_euler(velocity, noise.flatten(2), num_steps).unflatten(-1, (geometry.HORIZON, -1))


def _shrinkage(variance: float, num_steps: int) -> float:
    """What Euler integration multiplies a centred Gaussian coordinate of this target variance by."""
    factor = 1.0
    for step in range(num_steps):
        t = step / num_steps
        gain = (t * variance - (1 - t)) / ((1 - t) ** 2 + t**2 * variance)
        factor *= 1 + gain / num_steps
    return factor


def _moments_at(representation: RepresentationMap, path_spread: float, radius: np.ndarray) -> tuple[Tensor, Tensor]:
    """Mean (B, F) and covariance (B, F, F) of a mode at angle 0 in head A's space, at every radius (B,)."""
    radii, means, covariances = _moment_table(representation.name, path_spread)
    place = np.interp(radius, radii, np.arange(len(radii)))
    low = np.clip(place.astype(int), 0, len(radii) - 2)
    part = place - low
    mean = (1 - part)[:, None] * means[low] + part[:, None] * means[low + 1]
    covariance = (1 - part)[:, None, None] * covariances[low] + part[:, None, None] * covariances[low + 1]
    return torch.from_numpy(mean), torch.from_numpy(covariance)


@lru_cache(maxsize=8)
def _moment_table(name: str, path_spread: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    representation = REPRESENTATION_MAPS[name]
    generator = RingGenerator(2, path_spread=path_spread)
    radii = np.linspace(*geometry.RADIUS_RANGE, MOMENT_RADII)
    means, covariances = [], []
    for radius in radii:
        # The same draws at every radius, so that the moments vary smoothly with it.
        rng = np.random.default_rng(0)
        condition = np.broadcast_to(geometry.condition_vector(0.0, radius), (MOMENT_PATHS, 3))
        path = generator.draw_paths(rng, condition, np.zeros(MOMENT_PATHS, dtype=np.int64))
        values = representation.from_position(path).reshape(MOMENT_PATHS, -1)
        means.append(values.mean(axis=0))
        covariances.append(np.cov(values, rowvar=False))
    return radii, np.stack(means), np.stack(covariances)
