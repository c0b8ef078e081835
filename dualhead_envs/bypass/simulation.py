"""The physics of one scene: state, kinematics, contact with the obstacle, and exact snapshots."""

from __future__ import annotations

import numpy as np

from dualhead_envs.bypass.physics_engine import mujoco
from dualhead_envs.bypass.scene import OBSTACLE_BODY, OBSTACLE_GEOM, OBSTACLE_TOUCH, SceneForm, load_scene
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
#: The cube counts as lifted this far above the table (m).
LIFTED = 0.04
_HAND = "robot0_right_hand"
#: Reach of a finger in metres.
FINGER_RANGE = 0.04

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class PandaSimulation:
    """A Panda, a cube and an obstacle in MuJoCo.

    Attributes:
        model, data: MuJoCo's own.
        gripper: The gripper's set point, from -1 (open) to 1 (closed).
        touched: Whether anything touched the obstacle since the reset.
        goal: Where the cube belongs (3,) in m; the task's goal unless it was moved.
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
        self.goal = np.array(task.goal)
        self._push = self.data.xfrc_applied[mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, _HAND)][:3]
        self._obstacle_position = self.model.body_pos[self.model.body(OBSTACLE_BODY).id]

    def reset(self, cube_x: float, cube_y: float, cube_yaw: float) -> None:
        """The robot at its start with an open hand, the cube on the table at (x, y) in m, turned by yaw in rad."""
        mujoco.mj_resetData(self.model, self.data)
        self._obstacle_position[:] = self.task.obstacle_center
        self.goal = np.array(self.task.goal)
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
        cube, goal = self.cube_position, self.goal
        return self.cube_rests and float(np.hypot(cube[0] - goal[0], cube[1] - goal[1])) <= self.task.goal_radius

    @property
    def cube_rests(self) -> bool:
        """Whether the cube lies on the table, at rest."""
        task = self.task
        return (
            bool(self.cube_position[2] < task.goal_height)
            and float(np.linalg.norm(self.cube_velocity[:3])) <= task.goal_speed
        )

    @property
    def cube_lifted(self) -> bool:
        """Whether the cube is well above the table."""
        return bool(self.cube_position[2] > TABLE_HEIGHT + CUBE_HALF_SIZE + LIFTED)

    def push_hand(self, force: np.ndarray) -> None:
        """Let ``force`` (3,) in N, world frame, act on the hand until it is told otherwise."""
        self._push[:] = force

    def move_obstacle(self, offset: np.ndarray) -> None:
        """Put the obstacle ``offset`` (3,) in m beside its place, until the next reset."""
        self._obstacle_position[:] = self.task.obstacle_center + offset
        self.update_kinematics()

    def move_goal(self, offset: np.ndarray) -> None:
        """Put the goal ``offset`` (3,) in m beside its place, until the next reset."""
        self.goal = self.task.goal + offset

    def scale_cube_mass(self, factor: float) -> None:
        """Make the cube ``factor`` times as heavy, for good; call before the first reset."""
        self.model.body_mass[self._cube] *= factor
        self.model.body_inertia[self._cube] *= factor
        mujoco.mj_setConst(self.model, self.data)

    def scale_grip_friction(self, factor: float) -> None:
        """Make the sliding friction of cube and fingers ``factor`` times what it was, for good."""
        for geom in range(self.model.ngeom):
            body = self.model.body(self.model.geom_bodyid[geom]).name
            if body == "cube_main" or "finger" in body:
                self.model.geom_friction[geom, 0] *= factor

    @property
    def obstacle_position(self) -> np.ndarray:
        """Where the obstacle's centre is (3,) in m."""
        return self._obstacle_position.copy()

    def clearance(self, limit: float = 0.2) -> float:
        """Smallest distance (m, at most ``limit``) between the obstacle and anything that moves; ``limit`` without one.

        ``mj_geomDistance`` now and then reports a spurious 0 between a mesh and a box (measured): a distance of 0
        counts only if the touch sensor agrees.
        """
        model, nearest = self.model, limit
        if not self.task.has_obstacle:
            return limit
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


def observed_positions(agent: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Generalised positions (16,) of what an observation shows: seven joints, two fingers, the cube's pose.

    Args:
        agent: ``agent_pos``: joints first, the opening between the fingers last.
        state: ``environment_state``: the cube's position and the first two columns of its rotation first.
    """
    first, second = state[3:6], state[6:9]
    rotation = np.stack([first, second, np.cross(first, second)], axis=1)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    finger = agent[-1] / 2
    return np.concatenate([agent[:7], [finger, -finger], state[:3], quaternion])
