"""BimodalBypass-v2: past a wall, on the left or on the right, and on request over it."""

from __future__ import annotations

from typing import Any

from dualhead_envs.bypass.documentation import documented
from dualhead_envs.bypass.environment import BypassEnv
from dualhead_envs.bypass.layout import BIMODAL_BYPASS_LAYOUT
from dualhead_envs.bypass.partition import BIMODAL_TAU, BimodalPartition, BypassPartition, ThreeWayPartition
from dualhead_envs.bypass.task import BIMODAL_BYPASS, BIMODAL_WITHOUT_WALL, check_wall

_LAYOUT = BIMODAL_BYPASS_LAYOUT


@documented(_LAYOUT, BIMODAL_BYPASS.env_id)
class BimodalBypassEnv(BypassEnv):
    """A Panda carries a cube past a wall to a goal behind it, on the left or on the right.

    With ``ways=3`` there is a third mode, over the wall; scene, observations, actions and success stay the same. With
    ``obstacle="none"`` there is no wall, and observations report half extents of 0: the sides are then as far apart as
    the demonstrations' side step, ``amplitude``, makes them.

    The scene is robosuite 1.4.1's Lift with a wall and a goal (paper, sec:envs and app:prereg); MuJoCo steps it at
    500 Hz, 25 steps to one action (20 Hz).

    ## Observation space
    A dictionary of float32 arrays. Metres, radians, and the world frame of robosuite's Lift: x away from the
    robot's base, y to its left, z up.

    ``agent_pos``:

    {agent_pos}

    ``environment_state``:

    {environment_state}

    With ``pixels=True`` also ``pixels``, RGB (height, width, 3) uint8; this needs EGL or OSMesa.

    {action_space}

    ## Start and end of an episode
    The robot starts at rest above the table with an open hand; the cube's x is uniform in [-0.15, -0.09] m, y in
    [-0.03, 0.03] m and yaw in [-0.25, 0.25] rad, all from ``np_random``. ``reset(options={"state": s})`` restores
    ``s = env.unwrapped.state()`` exactly, at any point of an episode, or the start of a recorded episode from
    ``s = {"environment_state": first_frame}``. The episode terminates when the cube lies at the goal (within 0.05 m
    in the plane, below 0.83 m, slower than 0.05 m/s), or as a collision when anything touches the wall; it is
    truncated after 300 steps.

    ## Reward and info
    The reward is 1 on success and 0 otherwise. ``info`` holds, at reset and at every step, ``is_success`` (bool),
    ``mode`` (0 left, 1 right, 2 over, -1 undecided, of the path so far by ``mode_partition``; without ``ways=3`` a path
    over the wall is of no mode), ``collision`` (bool),
    ``failure``, why the episode would fail if it ended now (``none``, ``collision``; ``drop``: the cube fell though the
    hand was to hold it; ``miss``: it was let go beside the goal, or never lifted; ``timeout`` at step 300), and
    ``onset``, the control step at which the perturbation begins to act (-1: none, or not yet decided).

    {perturbations}

    ## Arguments
    ``control``; ``feed_forward`` (True: position and pose targets are tracked without lag, False: robosuite's law as
    it is); ``pixels``, ``render_mode`` (``"rgb_array"``), ``camera`` (a camera of the scene, or None for a view of
    the obstacle) and ``image_size`` (height, width); ``ways`` (2: left and right, 3: over as well); ``tau``, the
    partition's threshold in metres; ``perturbation``; ``obstacle`` (``"wall"`` or ``"none"``); ``amplitude``, how far
    aside demonstrations go without a wall, 0 to 0.2 m (None: as far as round the wall), which changes no episode.
    Their sides lie at +-``amplitude`` and the cube starts up to 0.03 m aside: below that, no threshold lets
    ``mode_partition`` tell them apart.
    """

    bypass = BIMODAL_BYPASS
    layout = _LAYOUT
    task_description = "Carry the cube past the wall, on either side, and drop it at the goal."

    def __init__(
        self,
        *,
        ways: int = 2,
        tau: float = BIMODAL_TAU,
        obstacle: str = "wall",
        amplitude: float | None = None,
        **settings: Any,
    ) -> None:
        check_wall(obstacle, amplitude)
        if obstacle == "none":
            self.bypass = BIMODAL_WITHOUT_WALL
        super().__init__(bimodal_partition(ways, tau), **settings)
        self._arguments |= {"ways": ways, "obstacle": obstacle, "amplitude": amplitude}
        self.demonstrated_amplitude = amplitude
        if obstacle == "none":
            self.task_description = "Carry the cube to the goal, on either side of the straight way, and drop it there."
        elif ways == 3:
            self.task_description = "Carry the cube past the wall, on either side or over it, and drop it at the goal."


def bimodal_partition(ways: int, tau: float = BIMODAL_TAU) -> BypassPartition:
    """The partition of the wall's ``ways``.

    Raises:
        ValueError: If ``ways`` is neither 2 nor 3, or ``tau`` is no positive length.
    """
    if ways not in (2, 3):
        raise ValueError(f"ways={ways!r} should be 2 (left, right) or 3 (left, right, over the wall)")
    return BimodalPartition(tau) if ways == 2 else ThreeWayPartition(tau)


def bimodal_bypass(**settings: Any) -> BimodalBypassEnv:
    """Entry point of the id: a function, so that the environment itself refuses ``render_mode="human"``."""
    return BimodalBypassEnv(**settings)
