"""The ring's observations and dual action vector, one layout per representation."""

from __future__ import annotations

from functools import cache

from dualhead_envs.layout import Dimension, Layout
from dualhead_envs.ring.geometry import RADIUS_RANGE
from dualhead_envs.ring.maps import representation_map

#: The arena is the square of positions with ``|x|, |y| <= ARENA`` metres.
ARENA = 10.0
FRAME = "world, origin at the ring's centre"


@cache
def ring_layout(representation: str) -> Layout:
    """The layout named ``ring/<representation>``.

    Raises:
        ValueError: If there is no such representation.
    """
    width = representation_map(representation).width
    joint = tuple(
        Dimension(f"joint.{representation}.{i}", "m", -ARENA, ARENA, f"coordinate {i} of the {representation} map")
        for i in range(width)
    )
    position = tuple(Dimension(f"position.{axis}", "m", -ARENA, ARENA, f"next point, {axis}") for axis in "xy")
    return Layout(
        name=f"ring/{representation}",
        agent_pos=tuple(Dimension(axis, "m", -ARENA, ARENA, f"current point, {axis}") for axis in "xy"),
        environment_state=(
            Dimension("cos_theta", "1", -1.0, 1.0, "cosine of the ring's rotation"),
            Dimension("sin_theta", "1", -1.0, 1.0, "sine of the ring's rotation"),
            Dimension("radius", "m", *RADIUS_RANGE, "radius of the ring"),
        ),
        action={"joint": joint, "position": position},
        controls={"joint": ("joint",), "position": ("position",)},
        kinematic_map=f"ring/{representation}",
        fps=20,
        frame=FRAME,
    )
