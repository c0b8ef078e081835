"""RotatingBypass-v3: past a suspended beam, by one of two routes that every episode draws anew."""

from __future__ import annotations

from typing import Any

from dualhead_envs.bypass.documentation import documented
from dualhead_envs.bypass.environment import BypassEnv
from dualhead_envs.bypass.layout import ROTATING_BYPASS_LAYOUT
from dualhead_envs.bypass.partition import ROTATING_TAU, RotatingPartition
from dualhead_envs.bypass.task import ROTATING_BYPASS

_LAYOUT = ROTATING_BYPASS_LAYOUT


@documented(_LAYOUT, ROTATING_BYPASS.env_id)
class RotatingBypassEnv(BypassEnv):
    """A Panda carries a cube past a suspended beam to a goal behind it, by one of two routes.

    Seen along x, the routes leave the point (y, z) = (0, 0.955) m at azimuths phi and phi + pi/2, to a radius R that
    is flattened by 0.68 vertically; the hand turns by 0.45 cos(azimuth) rad on the way. Both differ in every episode,
    so that no fixed coordinate tells the mode (paper, sec:envs). Scene, control rate and frames are those of
    :class:`~dualhead_envs.bypass.bimodal.BimodalBypassEnv`.

    ## Observation space
    A dictionary of float32 arrays. ``agent_pos``:

    {agent_pos}

    ``environment_state``; its last three numbers tell the unordered pair of routes without aliasing:

    {environment_state}

    With ``pixels=True`` also ``pixels``, RGB (height, width, 3) uint8; this needs EGL or OSMesa.

    {action_space}

    ## Start and end of an episode
    As in BimodalBypass-v2, and R uniform in [0.170, 0.215] m, theta uniform in [0, pi); phi = theta mod pi/2.

    ## Reward and info
    As in BimodalBypass-v2; ``mode`` is 0 for the route at phi, 1 for the one at phi + pi/2, -1 while undecided.

    {perturbations}

    ## Arguments
    As in BimodalBypass-v2.
    """

    bypass = ROTATING_BYPASS
    layout = _LAYOUT
    task_description = "Carry the cube past the beam, by either route, and drop it at the goal."

    def __init__(self, *, tau: float = ROTATING_TAU, **settings: Any) -> None:
        super().__init__(RotatingPartition(tau), **settings)


def rotating_bypass(**settings: Any) -> RotatingBypassEnv:
    """Entry point of the id: a function, so that the environment itself refuses ``render_mode="human"``."""
    return RotatingBypassEnv(**settings)
