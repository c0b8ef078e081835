"""RotatingRing as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from dualhead_envs.ribbon import Ribbon
from dualhead_envs.ring.geometry import HORIZON
from dualhead_envs.ring.layout import ring_layout
from dualhead_envs.ring.task import RingTask
from dualhead_envs.space_tables import with_space_tables

_LAYOUT = ring_layout("nullspace")


@with_space_tables(
    agent_pos=_LAYOUT.table(_LAYOUT.agent_pos),
    environment_state=_LAYOUT.table(_LAYOUT.environment_state),
    joint=_LAYOUT.table(_LAYOUT.action["joint"]),
    position=_LAYOUT.table(_LAYOUT.action["position"]),
)
class RotatingRingEnv(gym.Env):
    """A point goes from the centre of a ring out to one of K modes and back; every mode is equally right.

    The ring is rotated by theta and has radius r; both are drawn at reset. Mode k lies in the direction
    theta + 2 pi k / K. The task is the paper's synthetic testbed (appendix "Testbed and environment
    specification"): it has no dynamics to hide behind, and the expert's paths are Gaussian in each mode.

    ## Observation space
    A dictionary of float32 arrays, in metres in the world frame whose origin is the ring's centre.

    ``agent_pos``, the current point:

    {agent_pos}

    ``environment_state``, the condition:

    {environment_state}

    ## Action space
    The next point, in the representation that ``control`` names; it is reached exactly. With
    ``control="joint"``, head A's representation; for ``representation="nullspace"`` (two numbers of the same
    bounds for ``"orthogonal"`` and ``"polar"``):

    {joint}

    With ``control="position"``, the point itself:

    {position}

    An action may lie outside these bounds as long as the point that it commands lies in the arena, the square
    |x|, |y| <= 10 m. A point outside is a collision with the arena's wall: the agent stays where it is and
    the episode ends in failure. Nothing is clipped.

    ## Start and end of an episode
    The agent starts at the origin; theta is uniform on the circle, r uniform in [0.7, 1.3] m, both from
    ``np_random``. ``reset(options={"state": {"environment_state": (cos theta, sin theta, r)}})`` or
    ``{"state": {"theta": rad, "r": m}}`` restores a condition. After the 16th step the episode is truncated;
    if the path then has a valid mode it is also terminated, as a success. A collision terminates it at once.

    ## Reward and info
    The reward is 1 on success and 0 otherwise. ``info`` holds, at reset and at every step, ``is_success``
    (bool), ``mode`` (label of the path so far by ``mode_partition``, -1 undecided) and ``collision`` (bool).

    ## Arguments
    ``n_modes``, ``representation``, ``control``, ``mode_probabilities``, ``mode_angles``, ``path_spread``,
    ``tau`` and ``render_mode`` as in :class:`~dualhead_envs.ring.task.RingTask`. The prior and the spread
    belong to the scripted expert, ``generator``; the environment itself has no noise.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012  (Gymnasium's own convention)

    def __init__(self, n_modes: int = 2, *, render_mode: str | None = None, **settings: Any):
        self.ring = RingTask(n_modes, render_mode=render_mode, **settings)
        self.render_mode = render_mode
        self.layout = self.ring.layout
        self.generator = self.ring.generator
        self.mode_partition = self.ring.partition
        self.observation_space = self.layout.observation_space()
        self.action_space = self.layout.action_space(self.ring.control)
        # What lerobot-eval asks of an environment.
        self.task = f"RotatingRing-v{n_modes}"
        self.task_description = self.ring.description
        self._max_episode_steps = HORIZON
        self._condition: np.ndarray | None = None
        self._path = np.zeros((HORIZON, 2), dtype=np.float32)
        self._steps = 0
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode under a random or restored condition; see the class docstring.

        Raises:
            ValueError: If ``options`` holds anything but a valid ``state``.
        """
        super().reset(seed=seed)
        condition = self.ring.restored_condition(options)
        if condition is not None and condition.shape != (3,):
            raise ValueError(f"options['state'] describes {condition.shape[:-1]} environments, expected one")
        if condition is None:
            condition = self.generator.draw_conditions(self.np_random)
        self._condition = condition.astype(np.float32)
        self._path[:] = 0.0
        self._steps = 0
        self._ended = False
        return self._observation(), {"is_success": False, "mode": -1, "collision": False}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Move to the point that ``action`` commands.

        Raises:
            ValueError: If the action has the wrong shape or holds a number that is not finite.
            gymnasium.error.ResetNeeded: If the episode has ended or never begun.
        """
        if self._ended or self._condition is None:
            raise gym.error.ResetNeeded("the episode has ended or never begun: call reset() before step()")
        target = self.ring.decode(action)
        if target.shape != (2,):
            raise ValueError(f"the action commands {target.shape[:-1]} points, expected one: pass a single action")
        collision = not self.ring.inside_arena(target)
        self._path[self._steps] = self._position() if collision else target
        self._steps += 1
        mode = int(self.mode_partition.assign(self._path, self._condition))
        truncated = self._steps == HORIZON
        is_success = truncated and not collision and mode >= 0
        self._ended = collision or truncated
        info = {"is_success": is_success, "mode": mode, "collision": collision}
        return self._observation(), float(is_success), is_success or collision, truncated, info

    def render(self) -> np.ndarray | None:
        """The ring, its modes and the path so far: RGB (480, 480, 3) uint8, or None without render_mode.

        Raises:
            gymnasium.error.ResetNeeded: If there is no episode to show.
        """
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode: pass render_mode='rgb_array' to gym.make")
            return None
        return self.picture()

    def picture(self, ribbons: Sequence[Ribbon] = ()) -> np.ndarray:
        """What :meth:`render` shows, under any render_mode, with predicted paths (H, 2) drawn too.

        Raises:
            ValueError: If a ribbon has another shape.
            gymnasium.error.ResetNeeded: If there is no episode to show.
        """
        if self._condition is None:
            raise gym.error.ResetNeeded("there is no episode to show: call reset() before render()")
        from dualhead_envs.ring.rendering import draw_ring

        return draw_ring(self._path[: self._steps], self._condition, self.mode_partition, ribbons)

    def picture_of(self, observation: Mapping[str, np.ndarray], ribbons: Sequence[Ribbon] = ()) -> np.ndarray:
        """The ring of an observation at its start, whatever the episode, with predicted paths (H, 2) drawn too."""
        from dualhead_envs.ring.rendering import draw_ring

        return draw_ring(np.empty((0, 2)), observation["environment_state"], self.mode_partition, ribbons)

    def _position(self) -> np.ndarray:
        return self._path[self._steps - 1].copy() if self._steps else np.zeros(2, dtype=np.float32)

    def _observation(self) -> dict[str, np.ndarray]:
        assert self._condition is not None
        return {"agent_pos": self._position(), "environment_state": self._condition.copy()}


def rotating_ring(**settings: Any) -> RotatingRingEnv:
    """Entry point of the ids.

    A function, because Gymnasium wraps a *class* that renders ``rgb_array`` in a window when asked for
    ``"human"``; this way the environment itself refuses, with a sentence.
    """
    return RotatingRingEnv(**settings)
