"""The two-mode ring's optimum under endpoint consistency, behind the policy's sampling interface.

Under a linear map the path's coordinate along the envelope s decides the mode: a :class:`TwoModePair` in the plane.
Coordinates across s are Gaussian and independent of it, and there the optimum is linear.

Under ``polar`` each mode is replaced by the Gaussian with the moments of both heads' chunks, and the map by the linear
regression, step by step, of the position on head A's point over both modes; the result is approximate and says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.ring import geometry
from dualhead_envs.ring.generator import RingGenerator, envelope
from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap
from dualhead_eval.penalised_reference.conditional_expectation import Resolution
from dualhead_eval.penalised_reference.integration import integrate_gaussian, integrate_modes
from dualhead_eval.penalised_reference.ring_law import linear_law, matched_law
from dualhead_policy.flow.coupling import resolve_source_noise
from dualhead_policy.sampling import HeadSamples, SamplingCoupling


class PenalisedRingReference:
    """Samples both heads at the population optimum of flow matching plus endpoint consistency on a two-mode ring.

    Args:
        representation: ``"orthogonal"``, ``"nullspace"`` or, for opposite modes, ``"polar"`` (approximate).
        consistency_weight: lambda of eq:cons, at least 0.
        source_noise_beta: Coupling of the heads' source noise in (hypothetical) training, and in sampling when the
            caller does not choose another.
        mode_probabilities: Prior over the two modes; None: uniform.
        mode_angles: Offsets of the modes from theta in radians; None: opposite.
        path_spread: Standard deviation of delta in metres.
        resolution: Of the numerical solution.

    Raises:
        ValueError: If an argument is outside its range, or the representation has no linear map.
    """

    def __init__(
        self,
        representation: str,
        consistency_weight: float,
        *,
        source_noise_beta: float = 1.0,
        mode_probabilities: list[float] | None = None,
        mode_angles: list[float] | None = None,
        path_spread: float = geometry.PATH_SPREAD,
        resolution: Resolution | None = None,
    ):
        if representation not in REPRESENTATION_MAPS:
            raise ValueError(
                f"representation={representation!r} is not one of {sorted(REPRESENTATION_MAPS)}: choose one of these"
            )
        if not consistency_weight >= 0 or not 0 <= source_noise_beta <= 1:
            raise ValueError(
                f"consistency_weight={consistency_weight} must be at least 0 and "
                f"source_noise_beta={source_noise_beta} lie in [0, 1]: choose others"
            )
        self.generator = RingGenerator(2, mode_probabilities, mode_angles, path_spread)
        self.map = REPRESENTATION_MAPS[representation]
        self.exact = isinstance(self.map, LinearMap)
        if not self.exact and not np.allclose(np.diff(self.generator.angles), np.pi):
            raise ValueError(
                f"mode_angles={mode_angles!r} are not opposite: the penalised reference of {representation!r} needs "
                "modes that turn into each other by half a turn; leave mode_angles out or choose a linear map"
            )
        self.consistency_weight = consistency_weight
        self.source_noise_beta = source_noise_beta
        self.resolution = resolution or Resolution()
        self.head_dims = {"joint": self.map.width, "position": 2}

    @property
    def kinematic_map(self) -> str:
        """Name of the map from head A's space to the position."""
        return f"ring/{self.map.name}"

    def describe(self) -> dict[str, Any]:
        """Provenance: what this sampler is."""
        return {
            "method": "penalised reference" if self.exact else "penalised moment-matched reference (approximate)",
            "kinematic_map": self.kinematic_map,
            "n_modes": 2,
            "mode_probabilities": list(self.generator.probabilities),
            "path_spread": self.generator.path_spread,
            "source_noise_beta": self.source_noise_beta,
            "consistency_weight": self.consistency_weight,
            "grid_spacing": self.resolution.spacing,
            "quadrature_nodes": self.resolution.nodes,
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
        """Sample as ``DualheadPolicy.sample`` does; ``batch`` holds raw observations (B, dim).

        Raises:
            ValueError: If the coupling has a token or latent, which this reference does not.
        """
        coupling = coupling or SamplingCoupling()
        if coupling.token is not None or coupling.latent is not None:
            raise ValueError("the penalised reference has no token or latent to follow: sample it without either")
        condition = batch["observation.environment_state"].double().numpy()
        shape = (len(condition), num_samples, geometry.HORIZON)
        source = resolve_source_noise(coupling, shape, self.head_dims, self.source_noise_beta, generator)
        noise = {head: value.double().numpy() for head, value in source.items()}
        joint, position = np.empty(noise["joint"].shape), np.empty(noise["position"].shape)
        for row, one in enumerate(condition):
            ends = self._integrate(noise["joint"][row], noise["position"][row], one, num_steps or 20)
            joint[row], position[row] = ends
        return HeadSamples(torch.from_numpy(joint).float(), torch.from_numpy(position).float())

    def _integrate(
        self, joint: np.ndarray, position: np.ndarray, condition: np.ndarray, num_steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Euler integration of both heads under one condition (3,); noise (N, H, d_A) and (N, H, 2)."""
        weight, beta = self.consistency_weight, self.source_noise_beta
        if not isinstance(self.map, LinearMap):
            pair = matched_law(self.map, self.generator, condition, beta)
            flat_a, flat_b = joint.reshape(len(joint), -1), position.reshape(len(position), -1)
            ends = integrate_modes(pair, flat_a, flat_b, weight, num_steps, self.resolution)
            return ends[0].reshape(joint.shape), ends[1].reshape(position.shape)
        matrix, probabilities = self.map.matrix, self.generator.probabilities
        log_odds = float(np.log(probabilities[1] / probabilities[0]))
        length = float(np.linalg.norm(envelope()))
        unit = envelope() / length
        point = geometry.POINT_NOISE**2
        targets = length * condition[2] * geometry.mode_directions(condition, self.generator.angles)
        middle, half = targets.mean(axis=0), (targets[1] - targets[0]) / 2
        along = linear_law(matrix, half, self.generator.path_spread**2 * length**2 + point, beta, log_odds)
        across = linear_law(matrix, np.zeros(2), point, beta, 0.0)
        on_a, on_b = (np.einsum("nhd,h->nd", noise, unit) for noise in (joint, position))
        off_a, off_b = joint - unit[:, None] * on_a[:, None], position - unit[:, None] * on_b[:, None]
        ends_on = integrate_modes(along, on_a, on_b, weight, num_steps, self.resolution, matrix @ middle, middle)
        ends_off = integrate_gaussian(across, off_a, off_b, weight, num_steps)
        joint, position = (unit[:, None] * a[:, None] + b for a, b in zip(ends_on, ends_off, strict=True))
        return joint, position
