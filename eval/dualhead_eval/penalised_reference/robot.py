"""A robot's optimum under endpoint consistency: two demonstrated chunks per condition, kinematics along their chord.

Demonstrations of one initial state differ in their mode and hardly otherwise, so that the target under a test
condition is taken to be two points, the pair's own windows after the branch, each as likely, in normalised actions.
Kinematics are linear: the Jacobian averaged along the straight line between the two joint chunks, which maps their
difference to the positions' exactly (the mean value theorem). What this leaves out of head A's endpoints between the
modes is the bow of that line's image, reported by :attr:`PenalisedRobotReference.bow`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.func import jacrev, vmap

from dualhead_eval.penalised_reference.conditional_expectation import Resolution
from dualhead_eval.penalised_reference.integration import integrate_modes
from dualhead_eval.penalised_reference.two_mode_pair import TwoModePair
from dualhead_policy.flow.coupling import resolve_source_noise
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.sampling import HeadSamples, SamplingCoupling

#: Gauss-Legendre nodes along the chord; the Panda's Jacobian is smooth there.
CHORD_NODES = 5


class PenalisedRobotReference:
    """Samples both heads at the population optimum of flow matching plus endpoint consistency under known conditions.

    Args:
        observation: Raw observations of the conditions by LeRobot key, each (B, dim).
        joint: Joint chunks of both modes (B, 2, H, n) in rad.
        position: Position chunks of both modes (B, 2, H, d) in m.
        joint_scale, position_scale: Mean and standard deviation of the training actions, (n,) and (d,) each.
        kinematic_map: Forward kinematics.
        consistency_weight: lambda of eq:cons, at least 0.
        source_noise_beta: Coupling of the heads' source noise in (hypothetical) training, and in sampling when the
            caller does not choose another.
        resolution: Of the numerical solution.

    Attributes:
        bow: Largest distance in m, over conditions and steps, of the forward kinematics half-way between the modes
            from the point half-way between their positions.

    Raises:
        ValueError: If an argument is outside its range.
    """

    def __init__(
        self,
        observation: Mapping[str, np.ndarray],
        joint: np.ndarray,
        position: np.ndarray,
        joint_scale: tuple[np.ndarray, np.ndarray],
        position_scale: tuple[np.ndarray, np.ndarray],
        kinematic_map: KinematicMap,
        consistency_weight: float,
        *,
        source_noise_beta: float = 1.0,
        resolution: Resolution | None = None,
    ):
        if not consistency_weight >= 0 or not 0 <= source_noise_beta <= 1:
            raise ValueError(
                f"consistency_weight={consistency_weight} must be at least 0 and "
                f"source_noise_beta={source_noise_beta} lie in [0, 1]: choose others"
            )
        self.keys = sorted(observation)
        self.rows = {key: row for row, key in enumerate(map(bytes, self._fingerprints(observation)))}
        self.kinematics = kinematic_map
        self.consistency_weight = consistency_weight
        self.source_noise_beta = source_noise_beta
        self.resolution = resolution or Resolution()
        self.joint_scale, self.position_scale = joint_scale, position_scale
        self.joint = (joint - joint_scale[0]) / joint_scale[1]
        self.position = (position - position_scale[0]) / position_scale[1]
        self.horizon = joint.shape[2]
        self.head_dims = {"joint": joint.shape[-1], "position": position.shape[-1]}
        self.jacobian = chord_jacobian(kinematic_map, joint) * joint_scale[1] / position_scale[1][:, None]
        middle = kinematic_map.position(torch.from_numpy(joint.mean(axis=1))).numpy()
        self.bow = float(np.linalg.norm(middle - position.mean(axis=1), axis=-1).max())

    def _fingerprints(self, observation: Mapping[str, Any]) -> np.ndarray:
        return np.concatenate([np.asarray(observation[key], dtype=np.float32) for key in self.keys], axis=1)

    @property
    def kinematic_map(self) -> str:
        """Name of the map from head A's space to the position."""
        return self.kinematics.name

    def describe(self) -> dict[str, Any]:
        """Provenance: what this sampler is."""
        return {
            "method": "penalised reference (two-point law, chord kinematics)",
            "kinematic_map": self.kinematic_map,
            "n_modes": 2,
            "source_noise_beta": self.source_noise_beta,
            "consistency_weight": self.consistency_weight,
            "bow_of_chord_mm": 1e3 * self.bow,
            "grid_spacing": self.resolution.spacing,
            "quadrature_nodes": self.resolution.nodes,
        }

    def pair(self, row: int) -> TwoModePair:
        """The heads' joint law under condition ``row``, in normalised actions."""
        half_a, half_b = ((chunk[row, 1] - chunk[row, 0]).ravel() / 2 for chunk in (self.joint, self.position))
        steps, (d, n) = self.horizon, self.jacobian.shape[-2:]
        kinematics = np.zeros((steps, d, steps, n))
        kinematics[np.arange(steps), :, np.arange(steps)] = self.jacobian[row]
        return TwoModePair(
            half_a=half_a,
            half_b=half_b,
            kinematics=kinematics.reshape(steps * d, steps * n),
            covariance_a=np.zeros((steps * n, steps * n)),
            covariance_b=np.zeros((steps * d, steps * d)),
            covariance_ab=np.zeros((steps * n, steps * d)),
            noise_ab=(1 - self.source_noise_beta) * np.kron(np.eye(steps), np.eye(n, d)),
            loss_ratio=d / n,
        )

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
        """Sample as ``DualheadPolicy.sample`` does; ``batch`` holds raw observations (B, dim) of known conditions.

        Raises:
            ValueError: If the coupling has a token or latent, or a condition is not one that the reference was given.
        """
        coupling = coupling or SamplingCoupling()
        if coupling.token is not None or coupling.latent is not None:
            raise ValueError("the penalised reference has no token or latent to follow: sample it without either")
        rows = [self.rows.get(bytes(one), -1) for one in self._fingerprints(batch)]
        if -1 in rows:
            raise ValueError(
                "an observation is not among the conditions of the reference: expected the branch points of the split "
                "that it was opened on"
            )
        shape = (len(rows), num_samples, self.horizon)
        source = resolve_source_noise(coupling, shape, self.head_dims, self.source_noise_beta, generator)
        noise = {head: value.double().numpy().reshape(*shape[:2], -1) for head, value in source.items()}
        joint, position = np.empty(noise["joint"].shape), np.empty(noise["position"].shape)
        for i, row in enumerate(rows):
            joint[i], position[i] = integrate_modes(
                self.pair(row),
                noise["joint"][i],
                noise["position"][i],
                self.consistency_weight,
                num_steps or 20,
                self.resolution,
                self.joint[row].mean(axis=0).ravel(),
                self.position[row].mean(axis=0).ravel(),
            )
        return HeadSamples(
            torch.from_numpy(joint.reshape(*shape, -1) * self.joint_scale[1] + self.joint_scale[0]).float(),
            torch.from_numpy(position.reshape(*shape, -1) * self.position_scale[1] + self.position_scale[0]).float(),
        )


def chord_jacobian(kinematics: KinematicMap, joint: np.ndarray) -> np.ndarray:
    """The Jacobian averaged along the line between two modes' joint chunks (B, 2, H, n): (B, H, d, n) in m/rad."""
    place, weight = np.polynomial.legendre.leggauss(CHORD_NODES)
    jacobian = vmap(jacrev(kinematics.position))
    total = np.zeros(())
    for x, w in zip((place + 1) / 2, weight / 2, strict=True):
        pose = torch.from_numpy((1 - x) * joint[:, 0] + x * joint[:, 1])
        values = jacobian(pose.reshape(-1, pose.shape[-1])).numpy()
        total = total + w * values.reshape(*pose.shape[:2], *values.shape[1:])
    return total
