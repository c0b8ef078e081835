"""Forward kinematics: equal to the simulator's and to an independent library's, differentiable, composable."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from dualhead_envs.bypass.layout import JOINT_RANGES
from dualhead_envs.bypass.scene import load_scene
from dualhead_envs.bypass.task import BIMODAL_BYPASS, START_JOINTS
from dualhead_envs.ring.maps import REPRESENTATION_MAPS
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.kinematics.panda import PANDA_BASE, panda_position, panda_rotation

ROBOT_FILE = Path(str(distribution("robosuite").locate_file("robosuite"))) / "models/assets/robots/panda/robot.xml"


def configurations(n, dtype=torch.float64):
    low, high = torch.tensor(JOINT_RANGES, dtype=dtype).T
    return low + (high - low) * torch.rand(n, 7, dtype=dtype, generator=keyed_generator(n))


@pytest.fixture(scope="module")
def simulated():
    """Joint angles with the positions and rotations of the simulator's grip site."""
    model = load_scene(BIMODAL_BYPASS, "torque")
    data = mujoco.MjData(model)
    site = model.site("gripper0_grip_site").id
    joints, positions, rotations = configurations(300), [], []
    for configuration in joints.numpy():
        data.qpos[:7] = configuration
        mujoco.mj_kinematics(model, data)
        positions.append(data.site_xpos[site].copy())
        rotations.append(data.site_xmat[site].reshape(3, 3).copy())
    return joints, np.array(positions), np.array(rotations)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-6)])
def test_the_panda_agrees_with_the_simulators_grip_site(simulated, dtype, tolerance):
    joints, positions, rotations = simulated
    assert np.abs(panda_position(joints.to(dtype)).numpy() - positions).max() < tolerance
    assert np.abs(panda_rotation(joints.to(dtype)).numpy() - rotations).max() < 2 * tolerance


def test_the_panda_agrees_with_pytorch_kinematics_on_robosuites_robot_file():
    joints = configurations(200)
    hand = KinematicMap(f"file:{ROBOT_FILE}#right_hand").position(joints)
    # The hand's body lies 97 mm behind the grip site along the hand's third axis.
    ours = panda_position(joints) - 0.097 * panda_rotation(joints)[..., 2]
    assert (hand + torch.tensor(PANDA_BASE, dtype=hand.dtype) - ours).abs().max() < 1e-6


def test_at_the_start_the_hand_points_down_above_the_table():
    start = torch.tensor(START_JOINTS, dtype=torch.float64)
    assert panda_position(start).numpy() == pytest.approx([-0.10, 0, 1.01], abs=1e-3)
    assert panda_rotation(start)[:, 2].numpy() == pytest.approx([0, 0, -1], abs=1e-3)


def test_gradients_agree_with_finite_differences():
    joints = configurations(4).requires_grad_()
    assert torch.autograd.gradcheck(panda_position, joints)
    assert torch.autograd.gradcheck(panda_rotation, joints)


def test_the_panda_works_under_vmap_and_on_any_leading_axes():
    joints = configurations(12).reshape(3, 4, 7)
    jacobian = torch.func.vmap(torch.func.jacrev(panda_position))(joints[0])
    assert jacobian.shape == (4, 3, 7)
    assert torch.allclose(torch.func.vmap(panda_position)(joints), panda_position(joints))
    assert torch.equal(panda_rotation(joints)[1, 2], panda_rotation(joints[1, 2]))


@pytest.mark.slow
def test_the_panda_compiles():
    joints = configurations(64, torch.float32)
    assert torch.allclose(torch.compile(panda_position)(joints), panda_position(joints), atol=1e-6)


@pytest.mark.parametrize("name", REPRESENTATION_MAPS)
def test_the_rings_maps_agree_with_the_environments(name):
    ring_map = REPRESENTATION_MAPS[name]
    positions = np.random.default_rng(0).normal(size=(5, 16, 2))
    ours = KinematicMap(f"ring/{name}").position(torch.from_numpy(ring_map.from_position(positions)))
    assert ours.numpy() == pytest.approx(positions, abs=1e-12)


URDF = """<robot name="two"><link name="base"/><link name="arm"/><link name="tip"/>
<joint name="a" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><origin xyz="1 0 0"/><parent link="arm"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def test_another_robot_comes_as_a_urdf(tmp_path):
    path = tmp_path / "two.urdf"
    path.write_text(URDF)
    angle = torch.linspace(-1, 1, 6, dtype=torch.float64).reshape(2, 3)
    tip = KinematicMap(f"file:{path}#tip").position(torch.stack([angle, angle], dim=-1))
    expected = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)], dim=-1)
    assert torch.allclose(tip, expected, atol=1e-7)
    turn = KinematicMap(f"file:{path}#tip").rotation(torch.stack([angle, angle], dim=-1))
    assert torch.allclose(turn[..., 0, 0], (2 * angle).cos(), atol=1e-7)
    assert torch.allclose(turn[..., 1, 0], (2 * angle).sin(), atol=1e-7)


@pytest.mark.parametrize(
    ("name", "error", "sentence"),
    [
        ("elbow", ValueError, "not one of"),
        ("file:{robot}", ValueError, "not of the form 'file:PATH#LINK'"),
        ("file:{robot}#elbow", ValueError, "has no link 'elbow'"),
        ("file:{robot}.gone#tip", FileNotFoundError, "does not exist"),
        ("file:{text}#tip", ValueError, "is not XML"),
        ("file:{page}#tip", ValueError, "begins with neither <robot>"),
        ("file:{part}#tip", ValueError, "cannot be read as a kinematic chain"),
    ],
)
def test_kinematics_that_cannot_be_had_are_refused(tmp_path, name, error, sentence):
    files = {"robot": tmp_path / "two.urdf", "text": tmp_path / "two.txt", "page": tmp_path / "two.html"}
    files["part"] = tmp_path / "two.xml"
    part = '<mujoco><worldbody><body><joint name="a"/><joint name="b"/></body></worldbody></mujoco>'
    for path, content in zip(files.values(), (URDF, "two joints", "<html/>", part), strict=True):
        path.write_text(content)
    with pytest.raises(error, match=sentence):
        KinematicMap(name.format(**files)).require()


def test_a_configuration_of_another_width_is_refused():
    with pytest.raises(ValueError, match="7 joints, got 6"):
        panda_position(torch.zeros(2, 6))
    with pytest.raises(ValueError, match="has no orientation"):
        KinematicMap("ring/polar").rotation(torch.zeros(2))
