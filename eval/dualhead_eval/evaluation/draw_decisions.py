"""Decisions of a policy of LeRobot's other types in closed loop: several pairs of independent draws each."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from dualhead_envs.layout import Layout
from dualhead_eval.evaluation.decisions import OBSERVATIONS
from dualhead_policy.lerobot_policies.chunks import ChunkPolicy
from dualhead_policy.representation import require_observations

#: Columns of a recording's two draws.
DRAW_COLUMNS = ("draw_1", "draw_2")


class DrawDecisions:
    """Draws chunks whenever it is called; the first draw of the first pair is executed.

    Args:
        policy: The policy.
        samples: Pairs of draws per decision.
        window: Steps in which a mode is told; a shorter chunk is recorded whole.

    Attributes:
        predictions: The last decision's positions, as the dataset's columns.
        blank: The same columns where nothing was decided.
        chunk: Actions of the last decision that are still to be executed.
    """

    held = 0

    def __init__(self, policy: ChunkPolicy, samples: int, window: int) -> None:
        self.policy, self.samples, self.window = policy, samples, window
        self.interval, self.steps = policy.executed_steps, policy.denoising_steps
        self.past: deque[Mapping[str, Any]] = deque(maxlen=max(1, policy.n_obs_steps - 1))
        self.predictions: dict[str, np.ndarray] = {}
        self.blank: dict[str, np.ndarray] = {}
        self.widths: dict[str, int] = {}
        self.chunk: list[np.ndarray] = []
        self.horizon = 0

    def require_control(self, control: str) -> None:
        """The dual action holds what every control executes."""

    def require_layout(self, layout: Layout, env_id: str) -> None:
        """Refuse an environment that observes or acts in other dimensions.

        Raises:
            ValueError: In one sentence about the difference.
        """
        widths = {"observation.state": len(layout.agent_pos)}
        widths["observation.environment_state"] = len(layout.environment_state)
        shapes = self.policy.observation_shapes
        missing = sorted(shapes.keys() - widths.keys())
        if missing:
            raise ValueError(
                f"the policy observes {missing[0]}, which {env_id} does not show: roll out a policy of {sorted(widths)}"
            )
        require_observations(self.policy.policy.config.input_features or {}, widths)
        if self.policy.action_width != len(layout.action_names):
            raise ValueError(
                f"the policy's actions have {self.policy.action_width} dimensions, {env_id} takes the "
                f"{len(layout.action_names)} of the dual action vector: train on a dataset of `dualhead record`"
            )
        self._position = layout.action_slices["position"]
        width = self._position.stop - self._position.start
        probe = {key: torch.zeros(1, self.policy.n_obs_steps, *shape) for key, shape in shapes.items()}
        self.horizon = min(self.window, self.policy.draw(probe, 1, seed=0).shape[2])
        self.widths = dict.fromkeys(DRAW_COLUMNS, width)
        flat = self.samples * self.horizon * width
        self.blank = {f"prediction.{name}": np.zeros(flat, dtype=np.float32) for name in DRAW_COLUMNS}

    def start(self, seed: int) -> None:
        """Begin an episode: its draws, and an empty past."""
        self.seeds = np.random.default_rng(seed)
        self.past.clear()

    def observe(self, observation: Mapping[str, Any]) -> None:
        """Keep an observation for the decisions that look back."""
        self.past.append(observation)

    def __call__(self, observation: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Decide: draw the pairs, keep the first chunk to execute, return all positions (n, H, d).

        Raises:
            ValueError: If a chunk is not finite.
        """
        seen = [*self.past, observation] if self.policy.n_obs_steps > 1 else [observation]
        seen = [seen[0]] * (self.policy.n_obs_steps - len(seen)) + seen
        names = {key: name for name, key in OBSERVATIONS.items()}
        history = {
            key: torch.from_numpy(np.stack([step[names[key]] for step in seen]))[None]
            for key in self.policy.observation_shapes
        }
        drawn = self.policy.draw(history, 2 * self.samples, int(self.seeds.integers(2**63)))[0]
        if not torch.isfinite(drawn).all():
            raise ValueError("the policy predicted a number that is not finite")
        self.chunk = list(drawn[0, : self.interval].numpy())
        paths = drawn[:, : self.horizon, self._position].double().numpy()
        first, second = paths[: self.samples], paths[self.samples :]
        self.predictions = {
            f"prediction.{name}": path.astype(np.float32).reshape(-1)
            for name, path in zip(DRAW_COLUMNS, (first, second), strict=True)
        }
        return first, second
