"""Endpoint consistency (eq:cons): the heads' clean predictions should describe one motion.

Both losses act on the clean endpoints a = x_t + (1 - t) v of the same samples at the same time, in physical units;
on noisy intermediate states they would be ill-posed. All times t weigh alike.
"""

from __future__ import annotations

from torch import Tensor

from dualhead_policy.kinematics.kinematic_map import PositionMap, RotationMap
from dualhead_policy.kinematics.rotation6d import geodesic_angle, matrix_from_columns


def position_consistency(joint: Tensor, position: Tensor, to_position: PositionMap, deviation: Tensor) -> Tensor:
    """E |FK(a^1) - a^2|^2_W, the mean over samples, steps and coordinates.

    Args:
        joint: Clean endpoints of the joint head (B, H, d_A).
        position: Clean endpoints of the position head (B, H, d) in m.
        to_position: Forward kinematics FK.
        deviation: W^(-1/2) per coordinate (d,) in m: the unit in which a distance counts as one.
    """
    return ((to_position(joint) - position) / deviation).square().mean()


def rotation_consistency(joint: Tensor, columns: Tensor, to_rotation: RotationMap) -> Tensor:
    """The mean squared geodesic angle (rad^2) between the rotation of FK(a^1) and the rotation head's.

    Args:
        joint: Clean endpoints of the joint head (B, H, d_A).
        columns: Clean endpoints of the rotation head (B, H, 6).
        to_rotation: Forward kinematics, to rotation matrices.
    """
    return geodesic_angle(to_rotation(joint), matrix_from_columns(columns)).square().mean()
