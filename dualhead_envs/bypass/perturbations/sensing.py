"""Perturbations of what is observed; the robot and the scene are what they were."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dualhead_envs.bypass.perturbations.effect import (
    CUBE,
    CUBE_XY,
    GRIP_SITE,
    JOINTS,
    Constant,
    direction_in_plane,
)

if TYPE_CHECKING:
    from dualhead_envs.bypass.simulation import PandaSimulation


class CubeBias(Constant):
    """The cube is seen ``severity`` metres beside where it is, in one horizontal direction an episode."""

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        self._offset = self.severity * direction_in_plane(rng)[:2]

    def observe(self, agent_pos: np.ndarray, environment_state: np.ndarray, rng: np.random.Generator) -> None:
        environment_state[CUBE_XY] += self._offset


class JointBias(Constant):
    """The joint encoders are off by one vector (7,) an episode of ``severity`` rad; the grip site is reported truly.

    What is observed contradicts itself. The servos keep their own encoders: an action is executed as without bias.
    """

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        direction = rng.normal(size=7)
        self._offset = self.severity * direction / np.linalg.norm(direction)

    def observe(self, agent_pos: np.ndarray, environment_state: np.ndarray, rng: np.random.Generator) -> None:
        agent_pos[JOINTS] += self._offset


class Noise(Constant):
    """White noise at every step: ``severity`` rad on the joints, half as many metres on grip site and cube (sd)."""

    def observe(self, agent_pos: np.ndarray, environment_state: np.ndarray, rng: np.random.Generator) -> None:
        agent_pos[JOINTS] += self.severity * rng.normal(size=7)
        agent_pos[GRIP_SITE] += 0.5 * self.severity * rng.normal(size=3)
        environment_state[CUBE] += 0.5 * self.severity * rng.normal(size=3)
