"""robosuite's own environment in our scene, stepped by robosuite: the yardstick of tests and benchmarks.

Importing robosuite sets ``MUJOCO_GL`` and puts a stand-in for its private settings into ``sys.modules``: use this in
a process of its own.
"""

from __future__ import annotations

import sys
import types
from typing import Any

import numpy as np

from dualhead_envs.bypass.scene import scene_mjcf
from dualhead_envs.bypass.simulation import PandaSimulation
from dualhead_envs.bypass.task import START_JOINTS, BypassTask


class RobosuiteReference:
    """robosuite's ``OSC_POSE`` on absolute goals, or ``JOINT_POSITION``, at 20 Hz.

    Args:
        task: Which scene.
        controller: robosuite's name of the controller.
    """

    def __init__(self, task: BypassTask, controller: str = "OSC_POSE") -> None:
        lift, load_controller_config = _import_robosuite()
        settings = load_controller_config(default_controller=controller)
        if controller == "OSC_POSE":
            settings["control_delta"] = False
        self.env: Any = lift(
            robots="Panda", controller_configs=settings, has_renderer=False, has_offscreen_renderer=False,
            use_camera_obs=False, control_freq=20, ignore_done=True,
        )  # fmt: skip
        self.env.set_xml_processor(lambda _: scene_mjcf(task, "visual"))
        self.env.reset()

    def copy_state(self, simulation: PandaSimulation) -> None:
        """Take over positions, velocities and gripper of ``simulation``, and hold its angles in the null space."""
        robot, physics = self.env.robots[0], self.env.sim
        physics.data.qpos[:] = simulation.data.qpos
        physics.data.qvel[:] = simulation.data.qvel
        physics.forward()
        robot.gripper.current_action = np.array([-simulation.gripper, simulation.gripper])
        robot.controller.update_initial_joints(np.array(START_JOINTS))

    def step(self, position: np.ndarray, rotation: np.ndarray, gripper: float) -> np.ndarray:
        """One robosuite step towards ``position`` (3, m) and ``rotation`` (3, 3); where the grip site is then."""
        from scipy.spatial.transform import Rotation

        self.env.step(np.concatenate([position, Rotation.from_matrix(rotation).as_rotvec(), [gripper]]))
        return self.position

    @property
    def position(self) -> np.ndarray:
        """The grip site (3, m), up to date: robosuite's own observation is one physics step old."""
        self.env.sim.forward()
        return self.env.sim.data.get_site_xpos("gripper0_grip_site").copy()


def _import_robosuite() -> tuple[Any, Any]:
    private: Any = types.ModuleType("robosuite.macros_private")
    private.CONSOLE_LOGGING_LEVEL = "ERROR"
    private.MUJOCO_GPU_RENDERING = False
    sys.modules.setdefault("robosuite.macros_private", private)
    from robosuite.controllers import load_controller_config
    from robosuite.environments.manipulation.lift import Lift

    return Lift, load_controller_config
