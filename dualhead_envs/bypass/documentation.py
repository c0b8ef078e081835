"""The parts of the docstrings that both robot environments share, filled from layout and perturbations."""

from __future__ import annotations

from collections.abc import Callable

from dualhead_envs.bypass.perturbations.levels import LEVELS
from dualhead_envs.bypass.perturbations.perturbation import KINDS
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


_PERTURBATIONS = """\
## Perturbations
``perturbation="KIND:SEVERITY"``, in the unit of the kind, or ``perturbation="KIND@LEVEL"``, levels 1 to 4, disturbs
every episode. It begins like the unperturbed episode of the same seed; directions, moments and noise are functions of
that seed.

{table}"""


def documented[T: type](layout: Layout, env_id: str) -> Callable[[T], T]:
    """Class decorator: fill ``{agent_pos}``, ``{environment_state}``, ``{action_space}`` and ``{perturbations}``."""
    return with_space_tables(
        agent_pos=layout.table(layout.agent_pos),
        environment_state=layout.table(layout.environment_state),
        action_space=_ACTION_SPACE.format(**{group: layout.table(layout.action[group]) for group in layout.action}),
        perturbations=_PERTURBATIONS.format(table=perturbation_table(env_id)),
    )


def perturbation_table(env_id: str) -> str:
    """A Markdown table of the kinds of perturbation: severity's unit, the levels of ``env_id``, what happens."""
    rows = ["| kind | unit | levels 1 to 4 | what happens |", "| --- | --- | --- | --- |"]
    for name, kind in KINDS.items():
        levels = ", ".join(f"{severity:g}" for severity in LEVELS[env_id][name])
        rows.append(f"| {name} | {kind.unit} | {levels} | {kind.meaning} |")
    return "\n".join(rows)
