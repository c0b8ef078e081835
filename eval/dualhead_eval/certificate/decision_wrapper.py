"""A Gymnasium wrapper that decides every few steps and reports about the last decision in ``info``."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import gymnasium as gym


class DecisionWrapper(gym.Wrapper):
    """Decides at every reset and then at an interval, while the episode goes on.

    Args:
        env: The environment.
        decision_interval: Steps between decisions (the policy's ``n_action_steps``).

    Raises:
        ValueError: If the interval is below one step.
    """

    #: Key of the report in ``info``.
    key: str

    def __init__(self, env: gym.Env, decision_interval: int) -> None:
        super().__init__(env)
        if decision_interval < 1:
            raise ValueError(f"decision_interval={decision_interval}, expected at least 1 step")
        self._interval = decision_interval
        self._since_decision = 0
        self._step = 0

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and make the first decision."""
        observation, info = super().reset(**kwargs)
        self._step = self._since_decision = 0
        self.begin()
        self.decide(observation, 0)
        return observation, info | {self.key: self.report(decided=True)}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment; decide again when the interval is over and the episode goes on."""
        observation, reward, terminated, truncated, info = super().step(action)
        self._step += 1
        self._since_decision += 1
        due = self._since_decision >= self._interval and not (terminated or truncated)
        if due:
            self._since_decision = 0
            self.decide(observation, self._step)
        return observation, reward, terminated, truncated, info | {self.key: self.report(decided=due)}

    def begin(self) -> None:
        """Begin an episode."""

    @abstractmethod
    def decide(self, observation: Any, step: int) -> None:
        """Decide at an observation of control step ``step``."""

    @abstractmethod
    def report(self, *, decided: bool) -> dict[str, Any]:
        """What ``info`` says; ``decided`` is whether this step made a decision."""
