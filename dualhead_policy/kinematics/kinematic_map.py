"""The kinematic map: from head A's space to the position and, where there is a hand, to its rotation.

Differentiable, and named in a policy's representation:

- ``"panda"``: the grip site of robosuite's Panda, in its world frame (:mod:`dualhead_policy.kinematics.panda`);
- ``"ring/NAME"``: the ring's representation maps (:mod:`dualhead_envs.ring.maps`);
- ``"file:PATH#LINK"``: a link of any robot with a URDF or MJCF file
  (:mod:`dualhead_policy.kinematics.robot_file`).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap, PolarMap
from dualhead_policy.kinematics.panda import panda_position, panda_rotation
from dualhead_policy.kinematics.robot_file import (
    FILE_SCHEME,
    RobotDescription,
    parse_robot_file,
    read_carried_description,
    read_robot_file,
    write_carried_description,
)

PositionMap = Callable[[Tensor], Tensor]
RotationMap = Callable[[Tensor], Tensor]


class KinematicMap:
    """Forward kinematics of one representation.

    Args:
        name: ``"panda"``, ``"ring/NAME"`` or ``"file:PATH#LINK"``. A robot's file is opened when it is first needed.

    Raises:
        ValueError: If there is no such map.
    """

    def __init__(self, name: str):
        self.name = name
        self._position: PositionMap | None = None
        self._rotation: RotationMap | None = None
        self._robot: RobotDescription | None = None
        family, _, ring_map = name.partition("/")
        if name == "panda":
            self._position, self._rotation = panda_position, panda_rotation
        elif name.startswith(FILE_SCHEME):
            parse_robot_file(name)
        elif family == "ring" and ring_map in REPRESENTATION_MAPS:
            self._position = _ring_position(ring_map)
        else:
            known = ["panda", *(f"ring/{known}" for known in REPRESENTATION_MAPS), "file:PATH#LINK"]
            raise ValueError(f"kinematic map {name!r} is not one of {known}: choose one of these")

    def require(self) -> KinematicMap:
        """This map, after opening its robot's file if it has one.

        Raises:
            FileNotFoundError: If the robot's file is missing.
            ValueError: If it is no robot's description, or lacks the link.
        """
        if self._position is None:
            self._use(read_robot_file(self.name))
        return self

    def _use(self, robot: RobotDescription) -> None:
        self._robot, self._position, self._rotation = robot, robot.position, robot.rotation

    def position(self, values: Tensor) -> Tensor:
        """Positions (..., d) in m of points (..., d_A) in head A's space (rad on robots)."""
        self.require()
        assert self._position is not None
        return self._position(values)

    def rotation(self, values: Tensor) -> Tensor:
        """Rotation matrices (..., 3, 3), from the hand's frame to the world's, of joint values (..., n) in rad.

        Raises:
            ValueError: If the representation has no orientation.
        """
        self.require()
        if self._rotation is None:
            raise ValueError(
                f"kinematic map {self.name!r} has no orientation: expected 'panda' or a robot's file; leave the "
                "rotation head and its consistency out"
            )
        return self._rotation(values)

    def save(self, folder: Path) -> None:
        """Write what :meth:`load` needs beside the name into a policy's folder: nothing but for a robot's file."""
        self.require()
        if self._robot is not None:
            write_carried_description(self._robot, folder)

    @classmethod
    def load(cls, name: str, folder: Path) -> KinematicMap:
        """The map that :meth:`save` left in a policy's folder, which may be somebody else's.

        A robot's description comes from the copy in the folder; the path in its name is never opened.

        Raises:
            FileNotFoundError: If the folder lacks its robot.
            ValueError: If there is no map of this name, or the folder's robot is damaged or another one.
        """
        loaded = cls(name)
        if loaded._position is None:
            loaded._use(read_carried_description(name, folder))
        return loaded


def _ring_position(name: str) -> PositionMap:
    ring_map = REPRESENTATION_MAPS[name]
    if isinstance(ring_map, LinearMap):
        matrix = torch.from_numpy(ring_map.matrix)
        # A recorded CUDA graph cannot copy from the host: the matrix is brought to a device once, before recording.
        held: dict[tuple[torch.device, torch.dtype], Tensor] = {}

        def linear(values: Tensor) -> Tensor:
            place = (values.device, values.dtype)
            if place not in held:
                held[place] = matrix.to(*place)
            return values @ held[place]

        return linear
    assert isinstance(ring_map, PolarMap)

    def polar(values: Tensor) -> Tensor:
        radius = values.norm(dim=-1) ** (1 / ring_map.exponent)
        angle = torch.atan2(values[..., 1], values[..., 0]) - ring_map.twist * radius
        return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=-1)

    return polar
