"""RotatingRing as a native vector environment: N rings in one set of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from dualhead_envs.ring.geometry import HORIZON
from dualhead_envs.ring.task import RingTask


class RotatingRingVectorEnv(gym.vector.VectorEnv):
    """N copies of :class:`~dualhead_envs.ring.env.RotatingRingEnv` that agree with it bit for bit.

    ``reset(seed=s)`` seeds copy i with ``s + i``, a list seeds them one by one, as Gymnasium's own vector
    environments do. ``options={"state": ...}`` takes the same entries as the single environment, batched
    (N, ...) or shared. A copy whose episode has ended is reset by the next ``step``, which ignores its action
    (``AutoresetMode.NEXT_STEP``).

    Args:
        num_envs: Number of copies N.
        max_episode_steps: Truncate after so many steps; the task itself has 16.
        render_mode: ``None`` or ``"rgb_array"``.
        settings: As for the single environment.
    """

    metadata = {  # noqa: RUF012  (Gymnasium's own convention)
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        n_modes: int = 2,
        max_episode_steps: int = HORIZON,
        render_mode: str | None = None,
        **settings: Any,
    ):
        if num_envs < 1 or max_episode_steps < 1:
            raise ValueError(f"num_envs={num_envs} and max_episode_steps={max_episode_steps} should be at least 1")
        self.ring = RingTask(n_modes, render_mode=render_mode, **settings)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.layout = self.ring.layout
        self.generator = self.ring.generator
        self.mode_partition = self.ring.partition
        self.single_observation_space = self.layout.observation_space()
        self.single_action_space = self.layout.action_space(self.ring.control)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.task = f"RotatingRing-v{n_modes}"
        self.task_description = self.ring.description
        self._max_episode_steps = min(max_episode_steps, HORIZON)
        self._rngs: list[np.random.Generator | None] = [None] * num_envs  # made when first needed
        self._condition: np.ndarray | None = None
        self._path = np.zeros((num_envs, HORIZON, 2), dtype=np.float32)
        self._position = np.zeros((num_envs, 2), dtype=np.float32)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode in every copy.

        Raises:
            ValueError: If there is not one seed or state a copy, or ``options`` holds anything else.
        """
        seeds = self._seeds_of(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds were given for num_envs={self.num_envs}: pass one seed a copy")
        condition = self.ring.restored_condition(options)
        if condition is not None and condition.shape not in ((3,), (self.num_envs, 3)):
            raise ValueError(
                f"options['state'] describes {condition.shape[:-1]} environments, expected one or {self.num_envs}"
            )
        for i, one_seed in enumerate(seeds):
            if one_seed is not None:
                self._rngs[i] = seeding.np_random(one_seed)[0]
        self._condition = np.empty((self.num_envs, 3), dtype=np.float32)
        self._begin(np.ones(self.num_envs, dtype=bool), condition)
        nothing = np.zeros(self.num_envs, dtype=bool)
        return self._observation(), self._info(nothing, np.full(self.num_envs, -1), nothing)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Move every copy to the point that its row of ``actions`` (N, width) commands.

        Raises:
            ValueError: If there is not one finite action a running copy.
            gymnasium.error.ResetNeeded: If the environment was never reset.
        """
        if self._condition is None:
            raise gym.error.ResetNeeded("no episode has begun: call reset() before step()")
        values = np.asarray(actions)
        if values.ndim != 2 or len(values) != self.num_envs:
            raise ValueError(f"actions have shape {values.shape}, expected one row for each of {self.num_envs} copies")
        begin = self._ended.copy()
        if begin.any():
            values = np.where(begin[:, None], 0.0, values)
        target = self.ring.decode(values)
        collision = ~self.ring.inside_arena(target) & ~begin
        running = np.flatnonzero(~begin)
        np.copyto(self._position, target, where=~(collision | begin)[:, None], casting="same_kind")
        self._path[running, self._steps[running]] = self._position[running]
        self._steps[running] += 1
        if begin.any():
            self._begin(begin)
        mode = self.mode_partition.assign(self._path, self._condition)
        is_success = (self._steps == HORIZON) & (mode >= 0) & ~collision
        truncated = self._steps >= self._max_episode_steps
        terminated = is_success | collision
        self._ended = terminated | truncated
        info = self._info(is_success, mode, collision)
        return self._observation(), is_success.astype(np.float64), terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """One RGB image (480, 480, 3) uint8 a copy; None without render_mode."""
        if self.render_mode is None or self._condition is None:
            return None
        from dualhead_envs.ring.rendering import draw_ring

        return tuple(
            draw_ring(path[:steps], condition, self.mode_partition)
            for path, steps, condition in zip(self._path, self._steps, self._condition, strict=True)
        )

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """The attribute ``name``, or what it returns when called, once for each copy."""
        value = getattr(self, name)
        return (value(*args, **kwargs) if callable(value) else value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The attribute ``name``, once for each copy."""
        return (getattr(self, name),) * self.num_envs

    def _seeds_of(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        return list(seed)

    def _begin(self, which: np.ndarray, condition: np.ndarray | None = None) -> None:
        """Start episodes in the copies ``which`` (N,) bool, under drawn conditions unless they are given."""
        assert self._condition is not None
        if condition is None:
            for i in np.flatnonzero(which):
                rng = self._rngs[i] = self._rngs[i] or seeding.np_random()[0]
                self._condition[i] = self.generator.draw_conditions(rng)
        else:
            self._condition[which] = condition
        self._path[which] = 0.0
        self._position[which] = 0.0
        self._steps[which] = 0
        self._ended[which] = False

    def _observation(self) -> dict[str, np.ndarray]:
        assert self._condition is not None
        return {"agent_pos": self._position.copy(), "environment_state": self._condition.copy()}

    def _info(self, is_success: np.ndarray, mode: np.ndarray, collision: np.ndarray) -> dict[str, Any]:
        info: dict[str, Any] = {"is_success": is_success.copy(), "mode": mode, "collision": collision.copy()}
        return info | {f"_{key}": np.ones(self.num_envs, dtype=bool) for key in info}
