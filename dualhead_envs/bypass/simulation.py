"""The physics of one scene: state, kinematics, contact with the obstacle, and exact snapshots."""

from __future__ import annotations

import numpy as np

from dualhead_envs.bypass.physics_engine import mujoco
from dualhead_envs.bypass.scene import OBSTACLE_GEOM, OBSTACLE_TOUCH, SceneForm, load_scene
from dualhead_envs.bypass.task import CUBE_HALF_SIZE, START_JOINTS, TABLE_HEIGHT, BypassTask

JOINTS = 7
#: Where things lie in MuJoCo's state: seven arm joints, two fingers, the cube's free joint.
FINGERS = slice(7, 9)
CUBE_QPOS = slice(9, 16)
CUBE_QVEL = slice(9, 15)

#: Physics steps of 2 ms in one control step of 50 ms.
SUBSTEPS = 25
TIMESTEP = 0.002
CONTROL_PERIOD = SUBSTEPS * TIMESTEP
#: robosuite's gripper closes by this much of its range, -1 (open) to 1 (closed), in a physics step.
GRIPPER_RATE = 0.01
#: Reach of a finger in metres.
FINGER_RANGE = 0.04

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class PandaSimulation:
    """A Panda, a cube and an obstacle in MuJoCo.

    Attributes:
        model, data: MuJoCo's own.
        gripper: The gripper's set point, from -1 (open) to 1 (closed).
        touched: Whether anything touched the obstacle since the reset.
    """

    def __init__(self, task: BypassTask, form: SceneForm) -> None:
        self.task = task
        self.form: SceneForm = form
        self.model = load_scene(task, form)
        self.data = mujoco.MjData(self.model)
        self.site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, "gripper0_grip_site")
        self._cube = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "cube_main")
        self._obstacle = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, OBSTACLE_GEOM)
        touch = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, OBSTACLE_TOUCH)
        # Views of MuJoCo's memory: they follow the state without being read again.
        self.touch_force = self.data.sensordata[self.model.sensor_adr[touch] :][:1]
        self.joints = self.data.qpos[:JOINTS]
        self.joint_velocities = self.data.qvel[:JOINTS]
        self.fingers = self.data.qpos[FINGERS]
        self.cube_velocity = self.data.qvel[CUBE_QVEL]
        self.cube_position = self.data.xpos[self._cube]
        self.cube_rotation = self.data.xmat[self._cube].reshape(3, 3)
        self.position = self.data.site_xpos[self.site]
        self.rotation = self.data.site_xmat[self.site].reshape(3, 3)
        self.gripper_control = self.data.ctrl[FINGERS]
        self.gripper = -1.0
        self.touched = False

    def reset(self, cube_x: float, cube_y: float, cube_yaw: float) -> None:
        """The robot at its start with an open hand, the cube on the table at (x, y) in m, turned by yaw in rad."""
        mujoco.mj_resetData(self.model, self.data)
        self.joints[:] = START_JOINTS
        self.fingers[:] = (FINGER_RANGE, -FINGER_RANGE)
        half = 0.5 * cube_yaw
        self.data.qpos[CUBE_QPOS] = (
            cube_x, cube_y, TABLE_HEIGHT + CUBE_HALF_SIZE, np.cos(half), 0.0, 0.0, np.sin(half),
        )  # fmt: skip
        self._set_gripper(-1.0)
        self.touched = False
        self.update_kinematics()

    def update_kinematics(self) -> None:
        """Bring poses up to date with the joints: after a physics step MuJoCo's are one step (2 ms) old."""
        mujoco.mj_kinematics(self.model, self.data)

    def move_gripper(self, command: float) -> None:
        """Let the set point close (``command`` > 0), open (< 0) or stay, by one physics step's worth."""
        setting = self.gripper
        if command > 0.0:
            setting = min(setting + GRIPPER_RATE, 1.0)
        elif command < 0.0:
            setting = max(setting - GRIPPER_RATE, -1.0)
        if setting != self.gripper:
            self._set_gripper(setting)

    def _set_gripper(self, setting: float) -> None:
        self.gripper = setting
        finger = 0.5 * FINGER_RANGE * (1.0 - setting)
        self.gripper_control[0] = finger
        self.gripper_control[1] = -finger

    @property
    def opening(self) -> float:
        """Distance between the fingers in metres."""
        return float(self.fingers[0] - self.fingers[1])

    def cube_at_goal(self) -> bool:
        """Whether the cube lies at the goal, at rest."""
        task, cube = self.task, self.cube_position
        return (
            float(np.hypot(cube[0] - task.goal[0], cube[1] - task.goal[1])) <= task.goal_radius
            and bool(cube[2] < task.goal_height)
            and float(np.linalg.norm(self.cube_velocity[:3])) <= task.goal_speed
        )

    def clearance(self, limit: float = 0.2) -> float:
        """Smallest distance (m, at most ``limit``) between the obstacle and anything that moves.

        ``mj_geomDistance`` now and then reports a spurious 0 between a mesh and a box (measured): a distance of 0
        counts only if the touch sensor agrees.
        """
        model, nearest = self.model, limit
        for geom in range(model.ngeom):
            moves = model.body_weldid[model.geom_bodyid[geom]] != 0
            if not moves or not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
                continue
            distance = mujoco.mj_geomDistance(model, self.data, geom, self._obstacle, limit, None)
            if distance > 0.0 or self.touched:
                nearest = min(nearest, distance)
        return nearest

    def snapshot(self) -> np.ndarray:
        """Everything that the future depends on, as float64: MuJoCo's integration state, gripper, touched."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE) + 2)
        mujoco.mj_getState(self.model, self.data, state[:-2], _STATE)
        state[-2:] = self.gripper, self.touched
        return state

    @property
    def snapshot_size(self) -> int:
        """Length of a snapshot."""
        return mujoco.mj_stateSize(self.model, _STATE) + 2

    def restore(self, state: np.ndarray) -> None:
        """Return to a snapshot; what follows is the same bit for bit."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, np.ascontiguousarray(state[:-2]), _STATE)
        self._set_gripper(float(state[-2]))
        self.touched = bool(state[-1])
        self.update_kinematics()
