"""From an action to torques: the three controls, each one control step (50 ms, 25 physics steps) at a time.

All targets are absolute and mean "be there at the end of this control step", which is what the demonstrations
record (the measured state one step later).

``joint``     angles (7, rad): MuJoCo's position actuators with gravity compensation.
``position``  grip site (3, m, world); the rotation stays what it was at the start of the episode.
``pose``      grip site (3, m, world) and its rotation (6, the first two columns of the matrix).

With feed-forward the goal travels to the new target at constant velocity, no faster than the real robot may, and
damping acts on the velocity relative to the goal's. Without, the goal jumps to each new target, as in robosuite, and
the motion lags by about 2 / sqrt(kp) s. Position and pose use robosuite's operational-space law: without feed-forward
they are its default controller (gain 150, uncoupled), with feed-forward its stiffest (gain 300, coupled).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dualhead_envs.bypass.layout import JOINT_RANGES
from dualhead_envs.bypass.operational_space import operational_space_torque, rotate
from dualhead_envs.bypass.physics_engine import mujoco
from dualhead_envs.bypass.scene import SceneForm
from dualhead_envs.bypass.simulation import CONTROL_PERIOD, JOINTS, SUBSTEPS, TIMESTEP, PandaSimulation

#: Gain kp (1/s^2) at critical damping: robosuite's default, and what it is with feed-forward.
ROBOSUITE_STIFFNESS, TRACKING_STIFFNESS = 150.0, 300.0
#: Franka's limits for the Panda: joints (rad/s), the hand's speed (m/s) and its turning (rad/s). With feed-forward a
#: goal never travels faster, however far the target is; demonstrations stay below.
JOINT_SPEED = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
HAND_SPEED, HAND_TURN = 1.7, 2.5


class Control(Protocol):
    """One way to execute actions."""

    form: SceneForm

    def start(self, simulation: PandaSimulation) -> None:
        """Begin an episode from the simulation's present state."""

    def step(self, simulation: PandaSimulation, action: np.ndarray) -> None:
        """Execute ``action`` (float64, finite) for one control step."""

    def memory(self) -> np.ndarray:
        """What the control remembers of the episode (float64), for an exact snapshot."""

    def recall(self, memory: np.ndarray) -> None:
        """Return to a memory."""


class JointControl:
    """Joint targets (7, rad) and the gripper's command, by MuJoCo's own position actuators.

    An actuator's torque is ``kp (u - q) - kv dq``. Feed-forward commands ``u = goal + kv / kp * dgoal/dt``, which
    turns the damping into one on the velocity relative to the goal's. Targets beyond a joint's range mean its end.

    Args:
        feed_forward: Whether the goal travels to the target (see the module) or jumps.
    """

    form: SceneForm = "servo"

    def __init__(self, *, feed_forward: bool) -> None:
        self.feed_forward = feed_forward
        self._goal: np.ndarray = np.zeros(JOINTS)
        self._lead: np.ndarray = np.zeros(JOINTS)
        self._low, self._high = np.array(JOINT_RANGES).T

    def start(self, simulation: PandaSimulation) -> None:
        """Hold the present angles."""
        model = simulation.model
        self._goal = simulation.joints.copy()
        self._lead = -model.actuator_biasprm[:JOINTS, 2] / model.actuator_gainprm[:JOINTS, 0]

    def step(self, simulation: PandaSimulation, action: np.ndarray) -> None:
        """Execute ``action`` (8,)."""
        model, data, touch = simulation.model, simulation.data, simulation.touch_force
        goal = np.minimum(np.maximum(action[:JOINTS], self._low), self._high)
        command = float(action[JOINTS])
        control = data.ctrl[:JOINTS]
        travel = goal - self._goal
        moves = self.feed_forward and travel.any()
        if moves:
            excess = (np.abs(travel) / (JOINT_SPEED * CONTROL_PERIOD)).max()
            if excess > 1.0:
                travel /= excess
                goal = self._goal + travel
            travel /= SUBSTEPS
            control[:] = self._goal + self._lead / TIMESTEP * travel
        else:
            control[:] = goal
        for _ in range(SUBSTEPS):
            if moves:
                control += travel
            simulation.move_gripper(command)
            mujoco.mj_step(model, data)
            if touch[0] > 0.0:
                simulation.touched = True
        simulation.update_kinematics()
        self._goal = goal

    def memory(self) -> np.ndarray:
        """The last goal (7)."""
        return self._goal.copy()

    def recall(self, memory: np.ndarray) -> None:
        """Return to a memory."""
        self._goal = memory.copy()


class OperationalSpaceControl:
    """Targets of the grip site in the world frame, by robosuite's operational-space law.

    Args:
        with_rotation: Whether the action holds a rotation (6) after the position (3); else the start's is held.
        feed_forward: Whether the goal travels to the target (see the module) or jumps, as in robosuite.
    """

    form: SceneForm = "torque"

    def __init__(self, *, with_rotation: bool, feed_forward: bool) -> None:
        self.with_rotation = with_rotation
        self.feed_forward = feed_forward
        self._stiffness = np.full(6, TRACKING_STIFFNESS if feed_forward else ROBOSUITE_STIFFNESS)
        self._damping = 2.0 * np.sqrt(self._stiffness)
        self._posture: np.ndarray = np.zeros(JOINTS)
        self._goal_position: np.ndarray = np.zeros(3)
        self._goal_rotation: np.ndarray = np.eye(3)

    def start(self, simulation: PandaSimulation) -> None:
        """Hold the present pose, and draw the null space to the present angles."""
        self._posture = simulation.joints.copy()
        self._goal_position = simulation.position.copy()
        self._goal_rotation = simulation.rotation.copy()

    def step(self, simulation: PandaSimulation, action: np.ndarray) -> None:
        """Execute ``action``: position (3,), rotation (6,) if there is one, and the gripper's command."""
        rotation = rotation_matrix(action[3:9]) if self.with_rotation else self._goal_rotation
        self.step_to(simulation, action[:3], rotation, float(action[-1]))

    def step_to(self, simulation: PandaSimulation, position: np.ndarray, rotation: np.ndarray, gripper: float) -> None:
        """Go to ``position`` (3, m) and ``rotation`` (3, 3) for one control step."""
        velocity = np.zeros(6)
        if self.feed_forward:
            velocity = self._goal_velocity(position, rotation)
            excess = max(np.linalg.norm(velocity[:3]) / HAND_SPEED, np.linalg.norm(velocity[3:]) / HAND_TURN)
            if excess > 1.0:
                velocity /= excess
                position = self._goal_position + CONTROL_PERIOD * velocity[:3]
                rotation = rotate(CONTROL_PERIOD * velocity[3:], self._goal_rotation)
        model, data, site = simulation.model, simulation.data, simulation.site
        mass = np.empty((model.nv, model.nv))
        jacobian_position, jacobian_rotation = np.empty((3, model.nv)), np.empty((3, model.nv))
        limit = model.actuator_ctrlrange[:JOINTS, 1]
        touch, site_position, site_rotation = simulation.touch_force, data.site_xpos[site], data.site_xmat[site]
        qpos, qvel, bias, torque, inertia = data.qpos, data.qvel, data.qfrc_bias, data.ctrl[:JOINTS], data.qM
        goal_position, goal_rotation = position, rotation
        for substep in range(SUBSTEPS):
            if velocity.any():
                time_left = (SUBSTEPS - 1 - substep) * TIMESTEP
                goal_position = position - time_left * velocity[:3]
                goal_rotation = rotate(-time_left * velocity[3:], rotation)
            mujoco.mj_step1(model, data)
            mujoco.mj_jacSite(model, data, jacobian_position, jacobian_rotation, site)
            mujoco.mj_fullM(model, mass, inertia)
            operational_space_torque(
                mass, jacobian_position, jacobian_rotation, bias, qpos, qvel, site_position, site_rotation,
                goal_position, goal_rotation, velocity, self._posture, self._stiffness, self._damping,
                limit, self.feed_forward, torque,
            )  # fmt: skip
            simulation.move_gripper(gripper)
            mujoco.mj_step2(model, data)
            if touch[0] > 0.0:
                simulation.touched = True
        simulation.update_kinematics()
        self._goal_position, self._goal_rotation = position.copy(), rotation.copy()

    def _goal_velocity(self, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Velocity (6, m/s and rad/s) that takes the goal to the target in one step."""
        velocity = np.zeros(6)
        velocity[:3] = (position - self._goal_position) / CONTROL_PERIOD
        if rotation is not self._goal_rotation:
            velocity[3:] = rotation_vector(rotation @ self._goal_rotation.T) / CONTROL_PERIOD
        return velocity

    def memory(self) -> np.ndarray:
        """Posture (7), goal position (3) and goal rotation (9)."""
        return np.concatenate([self._posture, self._goal_position, self._goal_rotation.ravel()])

    def recall(self, memory: np.ndarray) -> None:
        """Return to a memory."""
        self._posture = memory[:JOINTS].copy()
        self._goal_position = memory[JOINTS : JOINTS + 3].copy()
        self._goal_rotation = memory[JOINTS + 3 :].reshape(3, 3).copy()


def rotation_matrix(columns: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) whose first two columns are nearest ``columns`` (6,), by Gram and Schmidt.

    Raises:
        ValueError: If the two columns are parallel or zero.
    """
    first, second = columns[:3], columns[3:]
    length = np.linalg.norm(first)
    x = first / length if length > 1e-6 else first
    y = second - (x @ second) * x
    width = np.linalg.norm(y)
    if length <= 1e-6 or width <= 1e-6:
        raise ValueError(
            f"rotation {np.array2string(columns, precision=3)} does not span a plane: give the first two columns "
            "of a rotation matrix"
        )
    y /= width
    return np.column_stack([x, y, np.cross(x, y)])


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle (3,) of a ``rotation`` (3, 3)."""
    axis = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        if np.trace(rotation) > 0.0:
            return axis
        # Half a turn: its axis is any column of R + 1.
        columns = rotation + np.eye(3)
        column = columns[:, np.argmax(np.diag(columns))]
        return np.pi * column / np.linalg.norm(column)
    return axis * (np.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0)) / sine)


def make_control(control: str, *, feed_forward: bool) -> Control:
    """The control of that name: ``"joint"``, ``"position"`` or ``"pose"`` (names checked by the layout)."""
    if control == "joint":
        return JointControl(feed_forward=feed_forward)
    return OperationalSpaceControl(with_rotation=control == "pose", feed_forward=feed_forward)
