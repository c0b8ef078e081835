"""What a perturbation may do to an episode: the hooks that the environment calls, each of which does nothing here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from dualhead_envs.bypass.simulation import PandaSimulation

#: Where things lie in the observation vectors (see :mod:`dualhead_envs.bypass.layout`).
JOINTS, GRIP_SITE = slice(0, 7), slice(14, 17)
CUBE, CUBE_XY = slice(0, 3), slice(0, 2)


class Effect:
    """An unperturbed episode, and the base of all perturbations.

    Args:
        severity: How strong, in the unit of the kind.

    Attributes:
        onset: The control step at which the perturbation begins to act; -1 while that is not decided.
    """

    def __init__(self, severity: float = 0.0) -> None:
        self.severity = severity
        self.onset = -1

    def prepare(self, simulation: PandaSimulation) -> None:
        """Change what is the same in every episode; called once."""

    def begin(self, rng: np.random.Generator, simulation: PandaSimulation, hold: np.ndarray) -> None:
        """Draw what the episode needs from ``rng`` and change the scene; ``hold`` is an action that moves nothing."""

    def observe(self, agent_pos: np.ndarray, environment_state: np.ndarray, rng: np.random.Generator) -> None:
        """Change what is observed, in place; ``rng`` is this step's own."""

    def act(self, action: np.ndarray, simulation: PandaSimulation, step: int) -> np.ndarray:
        """The action that is executed in place of ``action``; forces of this step are set in ``simulation``."""
        return action

    def follow(self, simulation: PandaSimulation, step: int) -> None:
        """Take note of the state after ``step`` control steps."""

    def memory(self) -> np.ndarray:
        """What the effect remembers of the episode beside its draws (float64), for an exact snapshot."""
        return np.empty(0)

    def recall(self, memory: np.ndarray) -> None:
        """Return to a memory."""


class Constant(Effect):
    """A perturbation that acts from the first observation to the last."""

    def __init__(self, severity: float) -> None:
        super().__init__(severity)
        self.onset = 0


def direction_in_plane(rng: np.random.Generator) -> np.ndarray:
    """A uniformly random horizontal unit vector (3,)."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.0])
