"""The part of the docstrings that both robot environments share, filled from their layout."""

from __future__ import annotations

from collections.abc import Callable

from dualhead_envs.layout import Layout
from dualhead_envs.space_tables import with_space_tables

_ACTION_SPACE = """\
## Action space
Absolute targets, to be reached at the end of the step. ``control="joint"`` takes joints and gripper:

{joint}

``control="position"`` takes the position and the gripper, and holds the rotation of the start:

{position}

``control="pose"`` takes the position, the rotation and the gripper:

{rotation}

In every control the gripper comes last:

{gripper}

Nothing is clipped: a target out of reach is approached as far as the arm goes."""


def documented[T: type](layout: Layout) -> Callable[[T], T]:
    """Class decorator: fill ``{action_space}``, ``{agent_pos}`` and ``{environment_state}`` of a docstring."""
    return with_space_tables(
        agent_pos=layout.table(layout.agent_pos),
        environment_state=layout.table(layout.environment_state),
        action_space=_ACTION_SPACE.format(**{group: layout.table(layout.action[group]) for group in layout.action}),
    )
