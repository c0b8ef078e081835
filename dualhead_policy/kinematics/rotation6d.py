"""Rotations by their first two columns (the continuous 6-D representation of Zhou et al. 2019), and angles."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

#: Added to the squared sine of an angle, so that its root can be differentiated at 0 (bias: 1e-6 rad).
SINE_FLOOR = 1e-12


def matrix_from_columns(columns: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of six numbers (..., 6), two columns one after the other, by Gram-Schmidt."""
    first = functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:] - (first * columns[..., 3:]).sum(dim=-1, keepdim=True) * first
    second = functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def columns_from_matrix(matrix: Tensor) -> Tensor:
    """The first two columns (..., 6) of rotation matrices (..., 3, 3)."""
    return torch.cat([matrix[..., 0], matrix[..., 1]], dim=-1)


def geodesic_angle(one: Tensor, other: Tensor) -> Tensor:
    """Angle (...) in rad, in [0, pi], of the rotation between two matrices (..., 3, 3); differentiable everywhere."""
    between = one.transpose(-1, -2) @ other
    cosine = (between.diagonal(dim1=-2, dim2=-1).sum(dim=-1) - 1) / 2
    axis = torch.stack(
        [
            between[..., 2, 1] - between[..., 1, 2],
            between[..., 0, 2] - between[..., 2, 0],
            between[..., 1, 0] - between[..., 0, 1],
        ],
        dim=-1,
    )
    sine = (axis.square().sum(dim=-1) / 4 + SINE_FLOOR).sqrt()
    return torch.atan2(sine, cosine)
