"""Forward kinematics of robosuite's Panda: differentiable, batched, fast enough for a training step.

The arm in Craig's modified Denavit-Hartenberg convention: the transform from link i to link i - 1 is
Rx(alpha_{i-1}) Tx(a_{i-1}) Rz(theta_i) Tz(d_i). A point of the hand is carried from the last link to the first
instead of multiplying transforms, and every alpha is a multiple of 90 degrees, so that a joint costs one plane
rotation and a swap of axes. Plain elementwise arithmetic: it works under ``torch.func.vmap`` and ``torch.compile``.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

#: (a_{i-1} in m, sin(alpha_{i-1}), d_i in m) of joints 1..7; cos(alpha) is 1 where the sine is 0, else 0.
PANDA_LINKS = (
    (0.0, 0, 0.333),
    (0.0, -1, 0.0),
    (0.0, 1, 0.316),
    (0.0825, 1, 0.0),
    (-0.0825, -1, 0.384),
    (0.0, 1, 0.0),
    (0.088, 1, 0.0),
)
#: The robot's base in robosuite's world (m): on the table's height, turned by nothing.
PANDA_BASE = (-0.56, 0.0, 0.912)
#: From link 7 to the grip site along z (m): robosuite's hand (0.1065) and its gripper (0.097).
GRIP_SITE_OFFSET = 0.1065 + 0.097
#: Turn of the grip site about z against link 7 (rad): robosuite's hand has the quaternion (0.924, 0, 0, -0.383),
#: and its gripper sits another quarter turn away. ``robot0_eef_quat`` is the hand's, hence a quarter turn off.
GRIP_SITE_TURN = -2 * math.atan2(0.383, 0.924) - math.pi / 2


def panda_position(joints: Tensor) -> Tensor:
    """Position of the grip site.

    Args:
        joints: Joint angles (..., 7) in rad.

    Returns:
        Positions (..., 3) in m, in robosuite's world frame.

    Raises:
        ValueError: If the last axis is not 7 wide.
    """
    sines, cosines = _sines_and_cosines(joints)
    # The grip site lies on the axis of joint 7, which therefore does not move it.
    zero = torch.zeros_like(sines[0])
    x, y, z = _through_link(6, zero, zero, zero + GRIP_SITE_OFFSET, 1.0)
    for link in reversed(range(6)):
        x, y = cosines[link] * x - sines[link] * y, sines[link] * x + cosines[link] * y
        x, y, z = _through_link(link, x, y, z, 1.0)
    return torch.stack([x + PANDA_BASE[0], y + PANDA_BASE[1], z + PANDA_BASE[2]], dim=-1)


def panda_rotation(joints: Tensor) -> Tensor:
    """Rotation matrix of the grip site.

    Args:
        joints: Joint angles (..., 7) in rad.

    Returns:
        Rotation matrices (..., 3, 3) from the grip site's frame to robosuite's world frame.

    Raises:
        ValueError: If the last axis is not 7 wide.
    """
    sines, cosines = _sines_and_cosines(joints)
    one, zero = torch.ones_like(sines[0]), torch.zeros_like(sines[0])
    turned, across = math.cos(GRIP_SITE_TURN), math.sin(GRIP_SITE_TURN)
    # The hand's first two axes in the frame of link 7, carried to the base; the third is their cross product.
    axes = []
    for x, y, z in ((turned * one, across * one, zero), (-across * one, turned * one, zero)):
        for link in reversed(range(7)):
            x, y = cosines[link] * x - sines[link] * y, sines[link] * x + cosines[link] * y
            x, y, z = _through_link(link, x, y, z, 0.0)
        axes.append(torch.stack([x, y, z], dim=-1))
    return torch.stack([*axes, torch.linalg.cross(axes[0], axes[1])], dim=-1)


def _through_link(link: int, x: Tensor, y: Tensor, z: Tensor, weight: float) -> tuple[Tensor, Tensor, Tensor]:
    """Rx(alpha) Tx(a) Tz(d) of a vector that Rz has turned; ``weight`` is 1 for points and 0 for directions."""
    a, sine, d = PANDA_LINKS[link]
    if weight and a:
        x = x + a
    if weight and d:
        z = z + d
    if sine > 0:
        return x, -z, y
    if sine < 0:
        return x, z, -y
    return x, y, z


def _sines_and_cosines(joints: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    if joints.shape[-1] != 7:
        raise ValueError(f"a Panda configuration has 7 joints, got {joints.shape[-1]}: pass angles (..., 7) in rad")
    return joints.sin().unbind(-1), joints.cos().unbind(-1)
