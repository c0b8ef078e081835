"""The Panda's layouts: every observed and commanded dimension of the two bypass environments.

Spaces, dataset features, policy features, names and the tables in the docstrings are generated from these.
"""

from __future__ import annotations

import math

from dualhead_envs.bypass.task import BIMODAL_BYPASS, ROTATING_BYPASS, BypassTask
from dualhead_envs.layout import Dimension, Layout

INF = math.inf
PANDA_JOINTS = 7
#: robosuite's Panda (rad); these are the model's own joint ranges.
JOINT_RANGES = (
    (-2.8973, 2.8973),
    (-1.7628, 1.7628),
    (-2.8973, 2.8973),
    (-3.0718, -0.0698),
    (-2.8973, 2.8973),
    (-0.0175, 3.7525),
    (-2.8973, 2.8973),
)
#: Positions that can be commanded (m, world): a box around the reach of the arm.
WORKSPACE = ((-0.56, 0.46), (-0.9, 0.9), (0.75, 1.8))
CONTROLS = {
    "joint": ("joint", "gripper"),
    "position": ("position", "gripper"),
    "pose": ("position", "rotation", "gripper"),
}


def _vector(prefix: str, unit: str, meaning: str, low: float = -INF, high: float = INF) -> list[Dimension]:
    return [Dimension(f"{prefix}.{axis}", unit, low, high, f"{meaning}, {axis}") for axis in "xyz"]


def _rotation(prefix: str, meaning: str) -> list[Dimension]:
    cells = [f"{meaning}, column {column}, row {row}" for column in (1, 2) for row in (1, 2, 3)]
    return [Dimension(f"{prefix}.{i}", "1", -1.0, 1.0, cell) for i, cell in enumerate(cells)]


def _agent_pos() -> list[Dimension]:
    return [
        *(Dimension(f"joint.{i}", "rad", -INF, INF, f"angle of joint {i + 1}") for i in range(PANDA_JOINTS)),
        *(
            Dimension(f"joint_velocity.{i}", "rad/s", -INF, INF, f"velocity of joint {i + 1}")
            for i in range(PANDA_JOINTS)
        ),
        *_vector("position", "m", "grip site in the world frame"),
        *_rotation("rotation", "rotation matrix of the grip site in the world frame"),
        Dimension("gripper.opening", "m", -INF, INF, "distance between the fingers"),
    ]


def _environment_state(task: BypassTask) -> list[Dimension]:
    dimensions = [
        *_vector("cube.position", "m", "centre of the cube in the world frame"),
        *_rotation("cube.rotation", "rotation matrix of the cube in the world frame"),
        *_vector("goal", "m", "goal in the world frame (constant)"),
        *_vector("obstacle.center", "m", "centre of the obstacle in the world frame (constant)"),
        *_vector("obstacle.half_size", "m", "half extent of the obstacle (constant)"),
    ]
    if task.route_radius is not None:
        low, high = task.route_radius
        dimensions += [
            Dimension("route.radius", "m", low, high, "R, radius of the two routes"),
            Dimension("route.cos", "1", 0.0, 1.0, "cos(phi), phi in [0, pi/2) is the first route's azimuth"),
            Dimension("route.sin", "1", 0.0, 1.0, "sin(phi); the second route's azimuth is phi + pi/2"),
        ]
    return dimensions


def _action() -> dict[str, tuple[Dimension, ...]]:
    joints = [
        Dimension(f"joint.{i}", "rad", low, high, f"target angle of joint {i + 1}")
        for i, (low, high) in enumerate(JOINT_RANGES)
    ]
    positions = [
        Dimension(f"position.{axis}", "m", low, high, f"target of the grip site in the world frame, {axis}")
        for axis, (low, high) in zip("xyz", WORKSPACE, strict=True)
    ]
    return {
        "joint": tuple(joints),
        "position": tuple(positions),
        "rotation": tuple(_rotation("rotation", "target rotation of the grip site in the world frame")),
        "gripper": (Dimension("gripper", "1", -1.0, 1.0, "below 0 opens, above 0 closes, 0 holds"),),
    }


def bypass_layout(task: BypassTask) -> Layout:
    """The layout of ``task``: the Panda's action, its proprioception and the task's context.

    A rotation is stored as the first two columns of its matrix, one after the other (6 numbers). The frame of the
    hand is the grip site's; robosuite's ``eef_quat`` belongs to the ``right_hand`` body, 90 degrees away about z.
    """
    return Layout(
        name="panda",
        agent_pos=tuple(_agent_pos()),
        environment_state=tuple(_environment_state(task)),
        action=_action(),
        controls=CONTROLS,
        kinematic_map="panda",
        fps=20,
        frame="world (robosuite's Lift); the hand's frame is the grip site",
    )


BIMODAL_BYPASS_LAYOUT = bypass_layout(BIMODAL_BYPASS)
ROTATING_BYPASS_LAYOUT = bypass_layout(ROTATING_BYPASS)
