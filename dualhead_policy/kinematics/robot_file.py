"""Forward kinematics of any robot described by a URDF or MJCF file, through pytorch-kinematics.

Slower than :mod:`dualhead_policy.kinematics.panda` and not for ``vmap``; the way to bring another robot.
"""

from __future__ import annotations

import contextlib
import io
import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from torch import Tensor

#: What ``kinematic_map`` starts with when it names a file.
FILE_SCHEME = "file:"
#: Parts of an MJCF that need other files or refer to parts left out; none of them moves a body.
_UNUSED_MJCF = ("asset", "actuator", "sensor", "contact", "tendon", "equality", "keyframe")


#: File of a policy's folder with the robot's description: JSON, which LeRobot uploads where it leaves XML behind.
CARRIED_FILE = "robot.json"
#: Descriptions that came with a policy, by the kinematic map that names the file they were copied from.
_carried: dict[str, str] = {}


def carry_robot_file(kinematic_map: str, folder: Path) -> None:
    """Copy the robot's description into a policy's folder, so that a deployed policy needs nothing else.

    Raises:
        FileNotFoundError: If the file is gone, and no folder brought a copy of it.
    """
    content = {"kinematic_map": kinematic_map, "description": _description(kinematic_map)}
    (folder / CARRIED_FILE).write_text(json.dumps(content), encoding="utf-8")


def use_carried_robot_file(kinematic_map: str, folder: Path) -> None:
    """Fall back on the copy in a policy's folder where the file that ``kinematic_map`` names does not exist.

    Raises:
        ValueError: If the copy is damaged.
    """
    copy = folder / CARRIED_FILE
    if not copy.is_file():
        return
    try:
        _carried[kinematic_map] = json.loads(copy.read_text(encoding="utf-8"))["description"]
    except (json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise ValueError(f"{copy} holds no robot's description ({error}): copy the policy's folder again") from error


def _description(kinematic_map: str) -> str:
    path, _ = parse_robot_file(kinematic_map)
    if not path.is_file():
        if kinematic_map in _carried:
            return _carried[kinematic_map]
        raise FileNotFoundError(f"{path} does not exist: give the path of the robot's URDF or MJCF file")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not XML ({error}): give the path of the robot's URDF or MJCF file") from error


def parse_robot_file(kinematic_map: str) -> tuple[Path, str]:
    """Path and link of ``"file:PATH#LINK"``.

    Raises:
        ValueError: If it is not spelled so.
    """
    path, separator, link = kinematic_map.removeprefix(FILE_SCHEME).rpartition("#")
    if not kinematic_map.startswith(FILE_SCHEME) or not separator or not path or not link:
        raise ValueError(
            f"kinematic map {kinematic_map!r} is not of the form 'file:PATH#LINK': name a URDF or MJCF file and the "
            "link whose position the position head predicts, for example 'file:robot.urdf#tool0'"
        )
    return Path(path), link


def robot_file_position(kinematic_map: str) -> Callable[[Tensor], Tensor]:
    """The map from joint values to the position of a link.

    Args:
        kinematic_map: ``"file:PATH#LINK"``; the link may be an MJCF site too.

    Returns:
        A function from joint values (..., n), in the chain's order from its root, in rad (m for slides), to
        positions (..., 3) in m, in the frame of the file's root.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no robot description, or its chain lacks the link.
    """
    to_pose = _pose(kinematic_map)
    return lambda values: to_pose(values)[..., :3, 3]


def robot_file_rotation(kinematic_map: str) -> Callable[[Tensor], Tensor]:
    """The map from joint values (..., n) to the link's rotation matrix (..., 3, 3), in the frame of the file's root.

    Raises as :func:`robot_file_position` does.
    """
    to_pose = _pose(kinematic_map)
    return lambda values: to_pose(values)[..., :3, :3]


def _pose(kinematic_map: str) -> Callable[[Tensor], Tensor]:
    _, link = parse_robot_file(kinematic_map)
    chain = _serial_chain(kinematic_map)
    joints = len(chain.get_joint_parameter_names())

    def to_pose(values: Tensor) -> Tensor:
        if values.shape[-1] != joints:
            raise ValueError(
                f"the chain to {link!r} has {joints} joints, got {values.shape[-1]}: pass joint values (..., {joints})"
            )
        moved = chain.to(dtype=values.dtype, device=values.device)
        matrix = moved.forward_kinematics(values.reshape(-1, joints)).get_matrix()
        return matrix.reshape(*values.shape[:-1], 4, 4)

    return to_pose


@cache
def _serial_chain(kinematic_map: str) -> Any:
    path, link = parse_robot_file(kinematic_map)
    try:
        root = ElementTree.fromstring(_description(kinematic_map))
    except ElementTree.ParseError as error:
        raise ValueError(f"{path} is not XML ({error}): give the path of the robot's URDF or MJCF file") from error
    if root.tag not in ("robot", "mujoco"):
        raise ValueError(
            f"{path} begins with <{root.tag}>, expected <robot> (URDF) or <mujoco> (MJCF): give the path of the "
            "robot's description"
        )
    # pytorch-kinematics prints its complaints about parts of the file that it does not use.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        import pytorch_kinematics

        try:
            if root.tag == "robot":
                chain = pytorch_kinematics.build_chain_from_urdf(ElementTree.tostring(root))
            else:
                chain = pytorch_kinematics.build_chain_from_mjcf(_bare_mjcf(root))
        except (KeyError, ValueError, AttributeError) as error:
            raise ValueError(
                f"{path} cannot be read as a kinematic chain ({error}): expected a robot of hinges and slides, one "
                "joint a body, without included files"
            ) from error
        links = chain.get_link_names() + chain.get_frame_names(exclude_fixed=False)
    if link not in links:
        shown = ", ".join(sorted(set(links))[:12])
        raise ValueError(f"{path} has no link {link!r}: choose one of its links ({shown}, ...)")
    return pytorch_kinematics.SerialChain(chain, link)


def _bare_mjcf(root: ElementTree.Element) -> str:
    """The bodies, joints and sites of an MJCF: meshes and textures would have to be found and read."""
    for part in [child for child in root if child.tag in _UNUSED_MJCF]:
        root.remove(part)
    for parent in list(root.iter()):
        for child in [child for child in parent if child.tag in ("geom", "camera", "light", "skin", "flex")]:
            parent.remove(child)
        for body in parent.findall("body"):
            # Objects that float in the scene; pytorch-kinematics knows hinges and slides only.
            if any(joint.get("type") in ("free", "ball") for joint in body.findall("joint")) or (
                body.find("freejoint") is not None
            ):
                parent.remove(body)
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root, "compiler")
    # MuJoCo wants every moving body to have inertia, which may have come from its geoms.
    compiler.attrib.update(boundmass="0.001", boundinertia="1e-6")
    return ElementTree.tostring(root, encoding="unicode")
