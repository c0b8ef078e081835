"""Perturbations of the scene: what the cube weighs and how it slides, where obstacle and goal are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dualhead_envs.bypass.perturbations.effect import Constant, direction_in_plane

if TYPE_CHECKING:
    from dualhead_envs.bypass.simulation import PandaSimulation


class Payload(Constant):
    """The cube is ``severity`` times as heavy; nothing that is observed tells before it is lifted."""

    def prepare(self, simulation: PandaSimulation) -> None:
        simulation.scale_cube_mass(self.severity)


class Friction(Constant):
    """The sliding friction of cube and fingers is ``severity`` times what it was; below 1 is harder."""

    def prepare(self, simulation: PandaSimulation) -> None:
        simulation.scale_grip_friction(self.severity)


class MovedObstacle(Constant):
    """The obstacle stands ``severity`` metres beside where it is reported, in a random horizontal direction.

    No observation shows it before something touches: a control, on which a monitor of the policy cannot do better than
    chance in time.
    """

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        simulation.move_obstacle(self.severity * direction_in_plane(rng))


class MovedGoal(Constant):
    """The goal, as reported, lies ``severity`` metres beside its place, in a random horizontal direction."""

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        simulation.move_goal(self.severity * direction_in_plane(rng))
