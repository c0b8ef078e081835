"""robosuite's operational-space law (Khatib 1987), compiled, for the Panda's seven joints.

    tau = J^T F + bias + N^T M (10 (q_0 - q) - 2 sqrt(10) dq)
    F = Lambda (kp dx + kd dv)                                      coupled
    F = [Lambda_p (kp dx_p + kd dv_p) ; Lambda_r (kp dx_r + kd dv_r)]   uncoupled

with N the projector onto J's null space, as in robosuite 1.4.1's ``OperationalSpaceController``, whose option
``uncouple_pos_ori`` chooses between the two (uncoupled is its default). The difference: dv is the velocity relative to
the goal's, which is zero in robosuite's law and the feed-forward in ours.

Uncoupled is the softer one: Lambda_p takes the hand for as light as it is when its wrist may give way, and pushes it
with a force that is too small when the rotation is held as well.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

JOINTS = 7
#: robosuite's stiffness of the posture in the null space (1/s^2).
POSTURE_STIFFNESS = 10.0


def _compiled(function: Callable) -> Callable:
    """Compile ``function``, and keep the result on disk where there is a place for it."""
    try:
        return numba.njit(cache=True)(function)
    except RuntimeError:  # neither the package's folder nor the user's cache can be written
        return numba.njit(function)


@_compiled
def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix (n, n), by Cholesky's factor."""
    n = matrix.shape[0]
    inverse_factor = np.zeros((n, n))
    factor = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                # A singular arm has a singular matrix: the floor keeps the torque finite there.
                factor[i, i] = np.sqrt(max(total, 1e-12))
            else:
                factor[i, j] = total / factor[j, j]
    for column in range(n):
        inverse_factor[column, column] = 1.0 / factor[column, column]
        for i in range(column + 1, n):
            total = 0.0
            for k in range(column, i):
                total -= factor[i, k] * inverse_factor[k, column]
            inverse_factor[i, column] = total / factor[i, i]
    return inverse_factor.T @ inverse_factor


@_compiled
def rotate(vector: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """``exp([vector]) @ rotation``: the (3, 3) ``rotation`` turned about ``vector`` (3,) by its length in rad."""
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if angle < 1e-12:
        return rotation.copy()
    x, y, z = vector[0] / angle, vector[1] / angle, vector[2] / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)) @ rotation


@_compiled
def operational_space_torque(
    mass: np.ndarray,
    jacobian_position: np.ndarray,
    jacobian_rotation: np.ndarray,
    bias: np.ndarray,
    joints: np.ndarray,
    velocities: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    goal_position: np.ndarray,
    goal_rotation: np.ndarray,
    goal_velocity: np.ndarray,
    posture: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    limit: np.ndarray,
    coupled: bool,
    torque: np.ndarray,
) -> None:
    """Write the arm's torque (7,) in N m, clipped to +-``limit``, into ``torque``.

    Args:
        mass: Joint-space inertia of the whole model (nv, nv); the arm is its first seven rows.
        jacobian_position, jacobian_rotation: The grip site's Jacobians (3, nv).
        bias: Coriolis and gravity (nv,).
        joints, velocities: Generalised positions (nq,) and velocities (nv,).
        position, rotation: The grip site's pose, (3,) in m and (9,) row-major, world frame.
        goal_position, goal_rotation: Where it should be, (3,) and (3, 3).
        goal_velocity: Linear and angular velocity of the goal (6,), zero for robosuite's law.
        posture: Joint angles (7,) that the null space is drawn to.
        stiffness, damping: Gains (6,).
        limit: Largest torque (7,).
        coupled: Which of the two forces.
        torque: Result.
    """
    inertia = np.ascontiguousarray(mass[:JOINTS, :JOINTS])
    jacobian = np.empty((6, JOINTS))
    jacobian[:3] = jacobian_position[:, :JOINTS]
    jacobian[3:] = jacobian_rotation[:, :JOINTS]
    joint_velocities = velocities[:JOINTS].copy()

    # Half the sum of the columns' cross products: robosuite's orientation error.
    error = np.zeros(3)
    for column in range(3):
        cx, cy, cz = rotation[column], rotation[3 + column], rotation[6 + column]
        gx, gy, gz = goal_rotation[0, column], goal_rotation[1, column], goal_rotation[2, column]
        error[0] += 0.5 * (cy * gz - cz * gy)
        error[1] += 0.5 * (cz * gx - cx * gz)
        error[2] += 0.5 * (cx * gy - cy * gx)

    twist = jacobian @ joint_velocities
    acceleration = np.empty(6)
    for i in range(3):
        acceleration[i] = stiffness[i] * (goal_position[i] - position[i])
        acceleration[3 + i] = stiffness[3 + i] * error[i]
    acceleration += damping * (goal_velocity - twist)

    compliance = jacobian @ _inverse(inertia) @ jacobian.T
    inverse_compliance = _inverse(compliance)
    wrench = np.empty(6)
    if coupled:
        wrench[:] = inverse_compliance @ acceleration
    else:
        wrench[:3] = _inverse(np.ascontiguousarray(compliance[:3, :3])) @ acceleration[:3]
        wrench[3:] = _inverse(np.ascontiguousarray(compliance[3:, 3:])) @ acceleration[3:]

    # N^T M a = M a - J^T Lambda J a, because N = I - M^-1 J^T Lambda J.
    pull = POSTURE_STIFFNESS * (posture - joints[:JOINTS]) - 2.0 * np.sqrt(POSTURE_STIFFNESS) * joint_velocities
    wrench -= inverse_compliance @ (jacobian @ pull)
    result = jacobian.T @ wrench + inertia @ pull
    for i in range(JOINTS):
        torque[i] = min(max(result[i] + bias[i], -limit[i]), limit[i])
