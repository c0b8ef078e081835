"""One episode under a perturbation, or under none: its key, its draws, its exact state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dualhead_envs.bypass.perturbations.effect import Effect
from dualhead_envs.bypass.perturbations.perturbation import Perturbation

if TYPE_CHECKING:
    from dualhead_envs.bypass.simulation import PandaSimulation

#: Streams of random numbers under an episode's key: what is drawn once, and what is drawn at every step.
_ONCE, _EVERY_STEP = 0, 1


class PerturbedEpisode:
    """Applies ``perturbation`` to the episodes of ``simulation``.

    Whatever is random is a function of the episode's key and, for noise, of the step. The key is drawn from the
    environment's generator after the initial state, and not at all without a perturbation: an episode begins as the
    unperturbed one of the same seed.
    """

    def __init__(self, perturbation: Perturbation | None, simulation: PandaSimulation) -> None:
        self.name = None if perturbation is None else str(perturbation)
        self._simulation = simulation
        self._effect = Effect() if perturbation is None else perturbation.effect()
        self._effect.prepare(simulation)
        self._key = 0

    @property
    def onset(self) -> int:
        """The control step at which the perturbation begins to act; -1 without one, or while that is not decided."""
        return self._effect.onset

    def draw_key(self, rng: np.random.Generator) -> int:
        """The key of a new episode; nothing is drawn without a perturbation."""
        return 0 if self.name is None else int(rng.integers(2**32))

    def begin(self, key: int, hold: np.ndarray) -> None:
        """Begin the episode of ``key`` in the simulation's present state; ``hold`` is an action that moves nothing."""
        self._key = key
        if self.name is not None:
            self._effect.begin(np.random.default_rng([key, _ONCE]), self._simulation, hold)

    def observe(self, agent_pos: np.ndarray, environment_state: np.ndarray, step: int) -> None:
        """Change what is observed after ``step`` control steps, in place."""
        if self.name is not None:
            rng = np.random.default_rng([self._key, _EVERY_STEP, step])
            self._effect.observe(agent_pos, environment_state, rng)

    def act(self, action: np.ndarray, step: int) -> np.ndarray:
        """The action that is executed in control step ``step`` (the first is 0) in place of ``action``."""
        return self._effect.act(action, self._simulation, step)

    def follow(self, step: int) -> None:
        """Take note of the state after ``step`` control steps."""
        self._effect.follow(self._simulation, step)

    def state(self) -> dict[str, Any] | None:
        """Name, key and memory; None without a perturbation."""
        return None if self.name is None else {"name": self.name, "key": self._key, "memory": self._effect.memory()}

    def checked(self, state: Any) -> tuple[int, np.ndarray]:
        """Key and memory of a :meth:`state` of the same perturbation.

        Raises:
            ValueError: If it is of another one.
        """
        name = state.get("name") if isinstance(state, Mapping) else state
        if name != self.name:
            raise ValueError(
                f"options['state'] was recorded under perturbation={name!r}, expected {self.name!r}: restore it in an "
                f"environment made with perturbation={name!r}"
            )
        return (0, np.empty(0)) if state is None else (int(state["key"]), np.asarray(state["memory"], np.float64))

    def recall(self, memory: np.ndarray) -> None:
        """Return to a memory, after :meth:`begin`."""
        self._effect.recall(memory)
