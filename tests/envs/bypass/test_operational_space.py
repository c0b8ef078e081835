"""The lean operational-space loop against robosuite's own environment."""

import json
import subprocess
import sys

import numpy as np

# robosuite in a process of its own: importing it changes the environment of this one.
COMPARE = """
import json
import numpy as np
from dualhead_envs.bypass.controllers import OperationalSpaceControl
from dualhead_envs.bypass.demonstrator import follow, grasp_and_lift, pass_and_release
from dualhead_envs.bypass.initial_state import InitialState
from dualhead_envs.bypass.robosuite_reference import RobosuiteReference
from dualhead_envs.bypass.simulation import PandaSimulation
from dualhead_envs.bypass.task import BIMODAL_BYPASS, ROTATING_BYPASS

results = {}
for task in (BIMODAL_BYPASS, ROTATING_BYPASS):
    initial = InitialState(-0.12, 0.01, 0.1, 0.2, 0.7)
    simulation = PandaSimulation(task, "torque")
    simulation.reset(initial.cube_x, initial.cube_y, initial.cube_yaw)
    control = OperationalSpaceControl(with_rotation=True, feed_forward=False)
    control.start(simulation)
    reference = RobosuiteReference(task)
    reference.copy_state(simulation)

    start = simulation.rotation.copy()
    legs = [*grasp_and_lift(initial), *pass_and_release(task, initial, 1, 0.165)]
    commands = follow(legs, simulation.position.copy())
    errors = []
    for position, yaw, gripper in zip(commands.positions, commands.yaws, commands.gripper, strict=True):
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        control.step_to(simulation, position, turn @ start, gripper)
        errors.append(np.linalg.norm(reference.step(position, turn @ start, gripper) - simulation.position))
    results[task.env_id] = {
        "steps": len(errors),
        "error": max(errors),
        "cube_x": float(simulation.data.qpos[9]),
        "touched": simulation.touched,
    }
print(json.dumps(results))
"""


def test_without_feed_forward_the_law_is_robosuites():
    answer = subprocess.run([sys.executable, "-W", "ignore", "-c", COMPARE], capture_output=True, text=True, check=True)
    for result in json.loads(answer.stdout.splitlines()[-1]).values():
        assert result["steps"] > 150
        assert result["error"] < 1e-6, "0.001 mm over a whole episode"
        assert result["cube_x"] > 0.1, "the episode grasps the cube and carries it past the obstacle"
        assert not result["touched"]


def test_the_spd_inverse_is_numpys():
    from dualhead_envs.bypass.operational_space import _inverse

    rng = np.random.default_rng(0)
    for n in (3, 6, 7):
        square = rng.normal(size=(n, n))
        matrix = square @ square.T + 0.1 * np.eye(n)
        np.testing.assert_allclose(_inverse(matrix), np.linalg.inv(matrix), rtol=1e-9, atol=1e-9)


def half_turn(axis):
    """The rotation by pi about ``axis`` (3,)."""
    axis = axis / np.linalg.norm(axis)
    return 2.0 * np.outer(axis, axis) - np.eye(3)


def test_rotating_by_a_vector_is_scipys():
    from scipy.spatial.transform import Rotation

    from dualhead_envs.bypass.controllers import rotation_matrix, rotation_vector
    from dualhead_envs.bypass.operational_space import rotate

    rng = np.random.default_rng(1)
    for _ in range(20):
        vector, start = rng.normal(size=3), Rotation.random(rng=rng)
        turned = rotate(vector, start.as_matrix())
        np.testing.assert_allclose(turned, (Rotation.from_rotvec(vector) * start).as_matrix(), atol=1e-12)
        np.testing.assert_allclose(rotate(rotation_vector(half_turn(vector)), np.eye(3)), half_turn(vector), atol=1e-9)
        small = 0.5 * vector / np.linalg.norm(vector)
        np.testing.assert_allclose(rotation_vector(Rotation.from_rotvec(small).as_matrix()), small, atol=1e-12)
        np.testing.assert_allclose(rotation_matrix(turned[:, :2].T.ravel()), turned, atol=1e-12)
