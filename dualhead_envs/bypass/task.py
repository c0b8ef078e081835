"""What is in the two scenes, where, and what counts as having done the task.

World frame: robosuite's Lift, x away from the robot's base, y to the robot's left, z up, metres; the table top is
at z = 0.8. Obstacle and goal are the paper's (app:prereg); ranges that the paper leaves open are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

Vector = tuple[float, float, float]

#: Half of the cube's edge in metres. robosuite draws it from [0.020, 0.022] at every hard reset; ours is fixed.
CUBE_HALF_SIZE = 0.021
#: Height of the table's surface in metres.
TABLE_HEIGHT = 0.8
#: Where the robot starts (rad): the grip site is at (-0.10, 0, 1.01), vertical, with the fingers along x, because
#: the hand is 204 mm wide along the fingers and would not clear the obstacle with its wide side first.
START_JOINTS = (0.0, 0.2150, 0.0, -2.5314, 0.0, 2.7463, -0.7849)


@dataclass(frozen=True)
class BypassTask:
    """One scene: its obstacle, goal and distribution of initial states.

    Attributes:
        env_id: The Gymnasium id.
        obstacle_center: Centre of the obstacle's box (m, world).
        obstacle_half_size: Half extents of that box (m); all 0 where nothing stands in the way.
        goal: Where the cube belongs (m, world).
        goal_radius: The cube is at the goal within this distance in the plane (m).
        goal_height: ... and below this height (m).
        goal_speed: ... and slower than this (m/s).
        cube_x, cube_y, cube_yaw: Ranges of the cube's initial position (m) and yaw (rad), uniform.
        route_radius: Range of the routes' radius R (m), uniform; None where routes are fixed.
    """

    env_id: str
    obstacle_center: Vector
    obstacle_half_size: Vector
    goal: Vector = (0.24, 0.0, 0.803)
    goal_radius: float = 0.05
    goal_height: float = 0.83
    goal_speed: float = 0.05
    cube_x: tuple[float, float] = (-0.15, -0.09)
    cube_y: tuple[float, float] = (-0.03, 0.03)
    cube_yaw: tuple[float, float] = (-0.25, 0.25)
    route_radius: tuple[float, float] | None = None

    @property
    def has_obstacle(self) -> bool:
        """Whether anything stands in the way."""
        return any(self.obstacle_half_size)


BIMODAL_BYPASS = BypassTask(
    env_id="BimodalBypass-v2",
    obstacle_center=(0.07, 0.0, 0.89),
    obstacle_half_size=(0.025, 0.09, 0.09),
)
#: The same without its wall: observations report a box without extent where it stood.
BIMODAL_WITHOUT_WALL = replace(BIMODAL_BYPASS, obstacle_half_size=(0.0, 0.0, 0.0))

#: How far aside (m) demonstrations can be asked to go where there is no wall.
MOST_AMPLITUDE = 0.2

ROTATING_BYPASS = BypassTask(
    env_id="RotatingBypass-v3",
    obstacle_center=(0.07, 0.0, 0.952),
    obstacle_half_size=(0.025, 0.062, 0.040),
    route_radius=(0.170, 0.215),
)

#: The centre (y, z) of v3's routes in metres, and how much they are flattened vertically (paper, sec:envs).
ROUTE_CENTER = (0.0, 0.955)
ROUTE_FLATTENING = 0.68
#: v3's yaw on the way past the obstacle is this times cos(psi), in rad (paper, sec:envs).
ROUTE_YAW = 0.45


def check_wall(obstacle: str, amplitude: float | None) -> None:
    """Refuse an obstacle that does not exist, and a side step that leads into the wall or out of reach.

    Raises:
        ValueError: In one sentence.
    """
    if obstacle not in ("wall", "none"):
        raise ValueError(f"obstacle={obstacle!r} should be 'wall' or 'none'")
    if amplitude is None:
        return
    if not (isinstance(amplitude, (int, float)) and 0 <= amplitude <= MOST_AMPLITUDE):
        raise ValueError(
            f"amplitude={amplitude!r} should be how far aside demonstrations go, 0 to {MOST_AMPLITUDE} m, for example "
            "0.02"
        )
    if obstacle != "none":
        raise ValueError(f"amplitude={amplitude!r} may lead into the wall: give obstacle='none' (--obstacle none) too")
