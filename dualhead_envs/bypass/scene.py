"""The scenes as MuJoCo models: robosuite's Lift with an obstacle and a goal, in the three forms that are needed.

``torque``: robosuite's own motors, for the operational-space law. ``servo``: native position actuators and gravity
compensation, for joint targets. Both hold only what collides, so that they load fast and step fast; ``visual``
holds everything and is compiled only when something is rendered.

Compiled models are kept in the user's cache (loading one takes 30 ms, compiling it over a second), keyed by the
versions of robosuite and MuJoCo and by the edited MJCF itself.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from typing import Literal

import numpy as np

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.bypass.lift_model import cache_directory, cache_key, lift_mjcf
from dualhead_envs.bypass.physics_engine import mujoco
from dualhead_envs.bypass.task import CUBE_HALF_SIZE, TABLE_HEIGHT, BypassTask

SceneForm = Literal["torque", "servo", "visual"]

#: Names of what this module adds.
OBSTACLE_BODY = "obstacle"
OBSTACLE_GEOM = "obstacle_collision"
OBSTACLE_TOUCH = "obstacle_touch"
GOAL_SITE = "goal"
SHADOW_SITE = "obstacle_shadow"

#: Stiffness of the joint servos (N m/rad). Damping is critical for a joint's own inertia in `SERVO_INERTIA`.
SERVO_STIFFNESS = (3600.0, 3600.0, 3600.0, 3600.0, 1500.0, 900.0, 450.0)
#: What a joint carries at the start, its armature included (kg m^2).
SERVO_INERTIA = (7.4, 5.0, 3.4, 2.8, 1.5, 1.2, 0.9)


def _text(values: tuple[float, ...] | list[float]) -> str:
    return " ".join(f"{value:.10g}" for value in values)


def _set_cube(root: ElementTree.Element) -> None:
    for geom in root.iter("geom"):
        if geom.get("name") in ("cube_g0", "cube_g0_vis"):
            geom.set("size", _text([CUBE_HALF_SIZE] * 3))


def _add_obstacle_and_goal(root: ElementTree.Element, task: BypassTask) -> None:
    world = root.find("worldbody")
    assert world is not None
    body = ElementTree.SubElement(world, "body", name=OBSTACLE_BODY, pos=_text(task.obstacle_center))
    if task.has_obstacle:
        size = _text(task.obstacle_half_size)
        ElementTree.SubElement(body, "geom", name=OBSTACLE_GEOM, type="box", size=size, group="0")
        ElementTree.SubElement(
            body, "geom", name="obstacle_visual", type="box", size=size, group="1",
            contype="0", conaffinity="0", rgba="0.20 0.32 0.47 1",
        )  # fmt: skip
    # The touch sensor counts contacts inside its site: a little larger than the obstacle.
    ElementTree.SubElement(
        body, "site", name=OBSTACLE_TOUCH, type="box", rgba="0 0 0 0", group="4",
        size=_text([half + 0.01 for half in task.obstacle_half_size]),
    )  # fmt: skip
    ElementTree.SubElement(
        world, "site", name=GOAL_SITE, type="cylinder", rgba="0.20 0.60 0.30 0.6", group="1",
        pos=_text([task.goal[0], task.goal[1], TABLE_HEIGHT + 0.0015]), size=_text([task.goal_radius, 0.001]),
    )  # fmt: skip
    sensors = root.find("sensor")
    assert sensors is not None
    ElementTree.SubElement(sensors, "touch", name=OBSTACLE_TOUCH, site=OBSTACLE_TOUCH)


def _servo(root: ElementTree.Element) -> None:
    actuators = root.find("actuator")
    assert actuators is not None
    for motor, stiffness, inertia in zip(actuators.findall("motor"), SERVO_STIFFNESS, SERVO_INERTIA, strict=True):
        limits = motor.get("ctrlrange", "")
        name, joint = motor.get("name", ""), motor.get("joint", "")
        motor.clear()
        motor.tag = "position"
        motor.attrib.update(
            name=name, joint=joint, kp=_text([stiffness]), kv=_text([2.0 * (stiffness * inertia) ** 0.5]),
            forcelimited="true", forcerange=limits,
        )  # fmt: skip
    for body in root.iter("body"):
        if body.get("name", "").startswith(("robot0_", "gripper0_")):
            body.set("gravcomp", "1")


def _dress(root: ElementTree.Element, task: BypassTask) -> None:
    """Hide robosuite's markers of the grip site, and give a suspended obstacle a shadow."""
    world = root.find("worldbody")
    assert world is not None
    for site in root.iter("site"):
        if site.get("name", "").startswith("gripper0_"):
            site.set("rgba", "0 0 0 0")
    (x, y, z), (half_x, half_y, half_z) = task.obstacle_center, task.obstacle_half_size
    if task.has_obstacle and z - half_z > TABLE_HEIGHT + 0.01:
        ElementTree.SubElement(
            world, "site", name=SHADOW_SITE, type="box", rgba="0 0 0 0.25", group="1",
            pos=_text([x, y, TABLE_HEIGHT + 0.001]), size=_text([half_x, half_y, 0.0005]),
        )  # fmt: skip


def _keep_physics(root: ElementTree.Element) -> None:
    compiler, sensors = root.find("compiler"), root.find("sensor")
    assert compiler is not None
    assert sensors is not None
    compiler.set("discardvisual", "true")
    # robosuite's wrist sensors are never read here and cost a pass over the kinematic tree at every step.
    for sensor in list(sensors):
        if sensor.tag != "touch":
            sensors.remove(sensor)


def scene_mjcf(task: BypassTask, form: SceneForm) -> str:
    """The MJCF of ``task`` in one of the three forms (see the module)."""
    root = ElementTree.fromstring(lift_mjcf())
    _set_cube(root)
    _add_obstacle_and_goal(root, task)
    if form == "servo":
        _servo(root)
    if form == "visual":
        _dress(root, task)
    if form != "visual":
        _keep_physics(root)
    return ElementTree.tostring(root, encoding="unicode")


def load_scene(task: BypassTask, form: SceneForm) -> mujoco.MjModel:
    """The compiled model of ``task``; from the cache where it is there, else compiled and put there."""
    mjcf = scene_mjcf(task, form)
    if form == "visual":  # 64 MB: not worth keeping
        return mujoco.MjModel.from_xml_string(mjcf)
    path = cache_directory() / f"{task.env_id}-{form}-{cache_key(mjcf)}.mjb"
    if path.exists():
        # A damaged file is compiled anew.
        with suppress(ValueError):
            return mujoco.MjModel.from_binary_path(str(path))
    model = mujoco.MjModel.from_xml_string(mjcf)
    with suppress(OSError):  # a read-only or full cache costs time, not the environment
        write_atomically(path, _binary(model))
    # As every later process reads it.
    return mujoco.MjModel.from_binary_path(str(path)) if path.exists() else model


def _binary(model: mujoco.MjModel) -> bytes:
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()
