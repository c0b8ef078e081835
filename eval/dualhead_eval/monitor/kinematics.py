"""Kinematic maps in NumPy: a decision's sixteen chunks in a fifth of the time that small torch tensors take."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.kinematics.panda import GRIP_SITE_OFFSET, PANDA_BASE, PANDA_LINKS

PositionMap = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def position_map(name: str) -> PositionMap:
    """Map ``(..., d_A)`` to positions ``(..., d)`` in m, for any name of a kinematic map.

    Raises:
        ValueError: If there is no such map.
    """
    if name == "panda":
        return panda_position
    family, _, ring_map = name.partition("/")
    if family == "ring" and isinstance(found := REPRESENTATION_MAPS.get(ring_map), LinearMap):
        matrix = np.asarray(found.matrix, dtype=np.float64)
        return lambda values: values @ matrix
    tensor_map = KinematicMap(name)
    return lambda values: tensor_map.position(torch.from_numpy(np.ascontiguousarray(values))).numpy()


def panda_position(joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grip site ``(..., 3)`` in m of the Panda's joint angles ``(..., 7)`` in rad.

    The same chain as :func:`dualhead_policy.kinematics.panda.panda_position`, whose constants it uses.
    """
    # Joint axis first, so that every sine is contiguous.
    angles = np.ascontiguousarray(np.moveaxis(joints, -1, 0)[:6])
    sines, cosines = np.sin(angles), np.cos(angles)
    x = np.full(angles.shape[1:], PANDA_LINKS[6][0])
    y, z = np.full(angles.shape[1:], -(PANDA_LINKS[6][2] + GRIP_SITE_OFFSET)), np.zeros(angles.shape[1:])
    for link in range(5, -1, -1):
        a, turn, d = PANDA_LINKS[link]
        x, y = cosines[link] * x - sines[link] * y + a, sines[link] * x + cosines[link] * y
        z = z + d
        if turn:
            y, z = (-z, y) if turn > 0 else (z, -y)
    return np.stack([x + PANDA_BASE[0], y + PANDA_BASE[1], z + PANDA_BASE[2]], axis=-1)
