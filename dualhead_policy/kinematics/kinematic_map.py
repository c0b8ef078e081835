"""The map from head A's space to the position, differentiable, by the name in a policy's representation.

- ``"panda"``: the grip site of robosuite's Panda, in its world frame (:mod:`dualhead_policy.kinematics.panda`);
- ``"ring/NAME"``: the ring's representation maps (:mod:`dualhead_envs.ring.maps`);
- ``"file:PATH#LINK"``: a link of any robot with a URDF or MJCF file.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap, PolarMap
from dualhead_policy.kinematics.panda import panda_position, panda_rotation

PositionMap = Callable[[Tensor], Tensor]
RotationMap = Callable[[Tensor], Tensor]


def position_map(kinematic_map: str) -> PositionMap:
    """The map (..., d_A) -> (..., d) in metres named by ``kinematic_map``.

    Raises:
        ValueError: If there is no such map, or a robot's file does not have the link.
        FileNotFoundError: If a robot's file is missing.
    """
    if kinematic_map == "panda":
        return panda_position
    if kinematic_map.startswith("file:"):
        from dualhead_policy.kinematics.robot_file import robot_file_position

        return robot_file_position(kinematic_map)
    family, _, name = kinematic_map.partition("/")
    if family == "ring" and name in REPRESENTATION_MAPS:
        ring_map = REPRESENTATION_MAPS[name]
        if isinstance(ring_map, LinearMap):
            return _linear(torch.from_numpy(ring_map.matrix))
        if isinstance(ring_map, PolarMap):
            return _polar(ring_map)
    known = ["panda", *(f"ring/{name}" for name in REPRESENTATION_MAPS), "file:PATH#LINK"]
    raise ValueError(f"kinematic map {kinematic_map!r} is not one of {known}: choose one of these")


def rotation_map(kinematic_map: str) -> RotationMap:
    """The map (..., d_A) -> (..., 3, 3), the rotation from the hand's frame to the world's.

    Raises:
        ValueError: If the representation has no orientation.
    """
    if kinematic_map == "panda":
        return panda_rotation
    if kinematic_map.startswith("file:"):
        from dualhead_policy.kinematics.robot_file import robot_file_rotation

        return robot_file_rotation(kinematic_map)
    raise ValueError(
        f"kinematic map {kinematic_map!r} has no orientation: expected 'panda' or a robot's file; leave the rotation "
        "head and its consistency out"
    )


def _linear(matrix: Tensor) -> PositionMap:
    return lambda values: values @ matrix.to(values)


def _polar(ring_map: PolarMap) -> PositionMap:
    def to_position(values: Tensor) -> Tensor:
        radius = values.norm(dim=-1) ** (1 / ring_map.exponent)
        angle = torch.atan2(values[..., 1], values[..., 0]) - ring_map.twist * radius
        return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=-1)

    return to_position
