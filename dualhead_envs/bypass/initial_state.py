"""What differs between episodes at their start: drawn, or read from the first frame of a recorded episode."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any, Self

import numpy as np

from dualhead_envs.bypass.task import BypassTask


@dataclass(frozen=True)
class InitialState:
    """What differs between episodes at their start.

    Attributes:
        cube_x, cube_y, cube_yaw: The cube on the table (m, m, rad).
        route_radius: R of v3's routes (m); 0 in v2.
        route_azimuth: theta of v3's routes in [0, pi) (rad); 0 in v2. The condition shows phi = theta mod pi/2
            only: which of the two routes the generator drew first is not for a policy to see.
    """

    cube_x: float
    cube_y: float
    cube_yaw: float
    route_radius: float = 0.0
    route_azimuth: float = 0.0

    @property
    def phi(self) -> float:
        """Azimuth of mode 0's route (rad), in [0, pi/2)."""
        return float(np.mod(self.route_azimuth, 0.5 * np.pi))

    @classmethod
    def draw(cls, task: BypassTask, rng: np.random.Generator) -> Self:
        """A random start of ``task``."""
        ranges = [task.cube_x, task.cube_y, task.cube_yaw]
        if task.route_radius is not None:
            ranges += [task.route_radius, (0.0, np.pi)]
        return cls(*(float(rng.uniform(low, high)) for low, high in ranges))

    @classmethod
    def recorded(cls, task: BypassTask, environment_state: Any) -> Self:
        """The start that a dataset's first frame describes, to float32's precision.

        Raises:
            ValueError: If ``environment_state`` is no first frame of ``task``.
        """
        values = np.asarray(environment_state, dtype=np.float64)
        width = 18 if task.route_radius is None else 21
        constants = np.array([*task.goal, *task.obstacle_center, *task.obstacle_half_size])
        if values.shape != (width,) or not np.isfinite(values).all() or np.abs(values[9:18] - constants).max() > 1e-4:
            raise ValueError(
                f"options['state']['environment_state'] has shape {values.shape} or describes another scene, expected "
                f"{width} finite numbers of {task.env_id}: use the first frame of one of its episodes"
            )
        (x_low, x_high), (y_low, y_high) = task.cube_x, task.cube_y
        if not (x_low - 0.05 < values[0] < x_high + 0.05 and y_low - 0.05 < values[1] < y_high + 0.05) or (
            abs(values[2] - 0.821) > 0.005
        ):
            raise ValueError(
                f"options['state']['environment_state'] has the cube at {np.round(values[:3], 3).tolist()}, which is "
                "not where an episode starts: use an episode's first frame, or env.unwrapped.state() for later ones"
            )
        yaw = float(np.arctan2(values[4], values[3]))
        if task.route_radius is None:
            return cls(values[0], values[1], yaw)
        return cls(values[0], values[1], yaw, values[18], float(np.arctan2(values[20], values[19])))

    def numbers(self) -> np.ndarray:
        """The five numbers, in order (float64)."""
        return np.array(astuple(self), dtype=np.float64)
