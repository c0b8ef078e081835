"""Perturbations of what is executed: late actions, and events while the cube is carried."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from dualhead_envs.bypass.perturbations.effect import Constant, Effect, direction_in_plane

if TYPE_CHECKING:
    from dualhead_envs.bypass.simulation import PandaSimulation

#: An event begins this many control steps at most after the cube was lifted, uniformly.
LONGEST_WAIT = 60
#: Control steps for which a push lasts (0.3 s).
PUSH_STEPS = 6


class Delay(Constant):
    """Every action is executed ``severity`` control steps late; until the first arrives, the robot holds still."""

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        self._queue = deque([hold] * round(self.severity))

    def act(self, action: np.ndarray, simulation: PandaSimulation, step: int) -> np.ndarray:
        self._queue.append(action)
        return self._queue.popleft()

    def memory(self) -> np.ndarray:
        return np.concatenate(list(self._queue))

    def recall(self, memory: np.ndarray) -> None:
        self._queue = deque(memory.reshape(round(self.severity), -1).copy())


class _Event(Effect):
    """Something that begins a random while after the cube was lifted."""

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        self.onset = -1
        self._wait = int(rng.integers(0, LONGEST_WAIT + 1))

    def follow(self, simulation: PandaSimulation, step: int) -> None:
        if self.onset < 0 and simulation.cube_lifted:
            self.onset = step + self._wait

    def memory(self) -> np.ndarray:
        return np.array([float(self.onset)])

    def recall(self, memory: np.ndarray) -> None:
        self.onset = int(memory[0])


class Slip(_Event):
    """The gripper opens for ``severity`` control steps, whatever it is told."""

    def act(self, action: np.ndarray, simulation: PandaSimulation, step: int) -> np.ndarray:
        if 0 <= self.onset <= step < self.onset + self.severity:
            return np.append(action[:-1], -1.0)
        return action


class Push(_Event):
    """A horizontal force of ``severity`` newtons on the hand for 0.3 s, in a random direction."""

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        super().begin(rng, simulation, hold)
        self._force = self.severity * direction_in_plane(rng)

    def act(self, action: np.ndarray, simulation: PandaSimulation, step: int) -> np.ndarray:
        acts = 0 <= self.onset <= step < self.onset + PUSH_STEPS
        simulation.push_hand(self._force if acts else np.zeros(3))
        return action
