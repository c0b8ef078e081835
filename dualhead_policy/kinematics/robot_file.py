"""A robot described by a URDF or MJCF file: its forward kinematics through pytorch-kinematics.

Slower than :mod:`dualhead_policy.kinematics.panda` and not for ``vmap``; the way to bring another robot. A policy
carries a copy of the description in its folder, so that it needs nothing else where it is loaded.
"""

from __future__ import annotations

import contextlib
import io
import json
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from torch import Tensor

#: What a kinematic map's name starts with when it names a file.
FILE_SCHEME = "file:"
#: File of a policy's folder with the robot's description: JSON, which LeRobot uploads where it leaves XML behind.
CARRIED_FILE = "robot.json"
#: Parts of an MJCF that need other files or refer to parts left out; none of them moves a body.
_UNUSED_MJCF = ("asset", "actuator", "sensor", "contact", "tendon", "equality", "keyframe")


@dataclass(frozen=True)
class RobotDescription:
    """One link of a robot.

    Attributes:
        name: ``"file:PATH#LINK"``, as the kinematic map is called; the link may be an MJCF site too.
        xml: The URDF or MJCF.
        source: Where the XML was read, for errors.
    """

    name: str
    xml: str
    source: Path

    def position(self, values: Tensor) -> Tensor:
        """Positions (..., 3) in m, in the frame of the file's root, of joint values (..., n) in rad (m for slides)."""
        return self._pose(values)[..., :3, 3]

    def rotation(self, values: Tensor) -> Tensor:
        """Rotation matrices (..., 3, 3), in the frame of the file's root, of joint values (..., n)."""
        return self._pose(values)[..., :3, :3]

    def _pose(self, values: Tensor) -> Tensor:
        joints = len(self.chain.get_joint_parameter_names())
        if values.shape[-1] != joints:
            _, link = parse_robot_file(self.name)
            raise ValueError(
                f"the chain to {link!r} has {joints} joints, got {values.shape[-1]}: pass joint values (..., {joints})"
            )
        moved = self.chain.to(dtype=values.dtype, device=values.device)
        matrix = moved.forward_kinematics(values.reshape(-1, joints)).get_matrix()
        return matrix.reshape(*values.shape[:-1], 4, 4)

    @cached_property
    def chain(self) -> Any:
        """The serial chain from the root to the link.

        Raises:
            ValueError: If the XML is no robot description, or lacks the link.
        """
        return _serial_chain(self.xml, parse_robot_file(self.name)[1], self.source)


def parse_robot_file(name: str) -> tuple[Path, str]:
    """Path and link of ``"file:PATH#LINK"``.

    Raises:
        ValueError: If it is not spelled so.
    """
    path, separator, link = name.removeprefix(FILE_SCHEME).rpartition("#")
    if not name.startswith(FILE_SCHEME) or not separator or not path or not link:
        raise ValueError(
            f"kinematic map {name!r} is not of the form 'file:PATH#LINK': name a URDF or MJCF file and the "
            "link whose position the position head predicts, for example 'file:robot.urdf#tool0'"
        )
    return Path(path), link


def read_robot_file(name: str) -> RobotDescription:
    """The robot of ``"file:PATH#LINK"``, checked.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no robot description, or its chain lacks the link.
    """
    path, _ = parse_robot_file(name)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist: give the path of the robot's URDF or MJCF file")
    try:
        description = RobotDescription(name, path.read_text(encoding="utf-8"), path)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not XML ({error}): give the path of the robot's URDF or MJCF file") from error
    assert description.chain is not None
    return description


def write_carried_description(description: RobotDescription, folder: Path) -> None:
    """Write the copy of a robot that :func:`read_carried_description` reads."""
    content = {"kinematic_map": description.name, "description": description.xml}
    (folder / CARRIED_FILE).write_text(json.dumps(content), encoding="utf-8")


def read_carried_description(name: str, folder: Path) -> RobotDescription:
    """The copy of a robot in a policy's folder, checked.

    Raises:
        FileNotFoundError: If the folder has none.
        ValueError: If the copy is damaged or of another robot.
    """
    copy = folder / CARRIED_FILE
    if not copy.is_file():
        raise FileNotFoundError(f"{copy} is missing: expected the description of {name!r}; copy the whole folder again")
    try:
        content = json.loads(copy.read_text(encoding="utf-8"))
        named, xml = content["kinematic_map"], content["description"]
        if not isinstance(xml, str) or named != name:
            raise ValueError(f"it describes {named!r}, the configuration names {name!r}")
    except (json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"{copy} holds no robot's description ({error}): copy the policy's folder again") from error
    description = RobotDescription(name, xml, copy)
    assert description.chain is not None
    return description


def _serial_chain(xml: str, link: str, source: Path) -> Any:
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise ValueError(f"{source} is not XML ({error}): give the path of the robot's URDF or MJCF file") from error
    if root.tag not in ("robot", "mujoco"):
        raise ValueError(
            f"{source} begins with <{root.tag}>, expected <robot> (URDF) or <mujoco> (MJCF): give the path of the "
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
                f"{source} cannot be read as a kinematic chain ({error}): expected a robot of hinges and slides, one "
                "joint a body, without included files"
            ) from error
        links = chain.get_link_names() + chain.get_frame_names(exclude_fixed=False)
    if link not in links:
        shown = ", ".join(sorted(set(links))[:12])
        raise ValueError(f"{source} has no link {link!r}: choose one of its links ({shown}, ...)")
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
