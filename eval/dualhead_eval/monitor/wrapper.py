"""A Gymnasium wrapper that runs a monitor beside a rollout and writes its reading into ``info["monitor"]``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import gymnasium as gym

from dualhead_eval.certificate.decision_wrapper import DecisionWrapper
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.monitor import Monitor, Reading


class MonitorWrapper(DecisionWrapper):
    """Attach a fitted monitor to one environment.

        env = MonitorWrapper(env, decide, monitor, decision_interval=8)
        observation, info = env.reset(seed=0)
        info["monitor"]["alarm"]

    ``info["monitor"]`` holds ``score``, ``aggregate``, ``threshold``, ``alarm`` (latched until the next reset) and
    ``step`` of the last decision, ``decision`` (whether this step made one), and the same of every signal in
    ``by_signal``.

    Args:
        env: Any environment.
        decide: The decision at a raw observation and control step, for example
            ``lambda observation, step: builder.build(step, ...)`` with a
            :class:`~dualhead_eval.monitor.decision_builder.DecisionBuilder`, which is what scores recordings too.
        monitor: A fitted monitor.
        decision_interval: Steps between decisions (the policy's ``n_action_steps``).

    Raises:
        ValueError: If the monitor has not been fitted.
    """

    key = "monitor"

    def __init__(
        self,
        env: gym.Env,
        decide: Callable[[Mapping[str, Any], int], Decision],
        monitor: Monitor,
        *,
        decision_interval: int = 8,
    ) -> None:
        super().__init__(env, decision_interval)
        if monitor.alpha is None:
            raise ValueError("the monitor has no threshold yet, expected a fitted one: call fit, or load_monitor")
        self.monitor = monitor
        self._decide = decide
        self._reading: Reading | None = None

    def begin(self) -> None:
        """Forget the last episode's decisions and alarm."""
        self.monitor.reset()

    def decide(self, observation: Mapping[str, Any], step: int) -> None:
        """Let the policy decide and read the decision."""
        self._reading = self.monitor.update(self._decide(observation, step))

    def report(self, *, decided: bool) -> dict[str, Any]:
        """The last reading."""
        assert self._reading is not None
        return asdict(self._reading) | {"decision": decided}
