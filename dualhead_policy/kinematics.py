"""The map from head A's space to the position, differentiable, by the name in a policy's representation."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap, PolarMap

PositionMap = Callable[[Tensor], Tensor]


def position_map(kinematic_map: str) -> PositionMap:
    """The map (..., d_A) -> (..., d) in metres named by ``kinematic_map``.

    Raises:
        ValueError: If there is no such map.
    """
    family, _, name = kinematic_map.partition("/")
    if family == "ring" and name in REPRESENTATION_MAPS:
        ring_map = REPRESENTATION_MAPS[name]
        if isinstance(ring_map, LinearMap):
            return _linear(torch.from_numpy(ring_map.matrix))
        if isinstance(ring_map, PolarMap):
            return _polar(ring_map)
    known = [f"ring/{name}" for name in REPRESENTATION_MAPS]
    raise ValueError(f"kinematic map {kinematic_map!r} is not one of {known}: choose one of these")


def _linear(matrix: Tensor) -> PositionMap:
    return lambda values: values @ matrix.to(values)


def _polar(ring_map: PolarMap) -> PositionMap:
    def to_position(values: Tensor) -> Tensor:
        radius = values.norm(dim=-1) ** (1 / ring_map.exponent)
        angle = torch.atan2(values[..., 1], values[..., 0]) - ring_map.twist * radius
        return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=-1)

    return to_position
