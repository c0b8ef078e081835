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

from dualhead_envs.validated_json import Schema, read_validated, shown
from dualhead_policy.hub_folder import file_inside
from dualhead_policy.kinematics.robot_xml import ADVICE, MAX_CHARACTERS, parse_robot_xml

#: What a kinematic map's name starts with when it names a file.
FILE_SCHEME = "file:"
#: File of a policy's folder with the robot's description: JSON, which LeRobot uploads where it leaves XML behind.
CARRIED_FILE = "robot.json"


class CarriedDescription(Schema):
    """``robot.json`` of a policy's folder."""

    kinematic_map: str
    description: str


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
    if path.stat().st_size > 4 * MAX_CHARACTERS:
        raise ValueError(f"{path} has {path.stat().st_size} bytes, too many for a robot: {ADVICE}")
    try:
        description = RobotDescription(name, path.read_text(encoding="utf-8"), path)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not XML (not UTF-8): {ADVICE}") from error
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
    remedy = "copy the policy's whole folder again"
    copy = file_inside(folder, CARRIED_FILE)
    content = read_validated(copy, CarriedDescription, kind="a robot's description", remedy=remedy)
    if content.kinematic_map != name:
        raise ValueError(f"{copy} describes another robot than config.json names: {remedy}")
    description = RobotDescription(name, content.description, copy)
    assert description.chain is not None
    return description


def _serial_chain(xml: str, link: str, source: Path) -> Any:
    root = parse_robot_xml(xml, source)
    # pytorch-kinematics prints its complaints about parts of the file that it does not use.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        import pytorch_kinematics

        try:
            if root.tag == "robot":
                chain = pytorch_kinematics.build_chain_from_urdf(ElementTree.tostring(root))
            else:
                chain = pytorch_kinematics.build_chain_from_mjcf(ElementTree.tostring(root, encoding="unicode"))
            links = chain.get_link_names() + chain.get_frame_names(exclude_fixed=False)
            serial = pytorch_kinematics.SerialChain(chain, link) if link in links else None
        # Three parsers, of URDF, MJCF and numbers, raise whatever they trip over.
        except Exception as error:
            raise ValueError(
                f"{source} cannot be read as a kinematic chain ({type(error).__name__}): expected a robot of hinges "
                "and slides, one joint a body, without included files"
            ) from error
    if serial is None:
        known = ", ".join(sorted(shown(name) for name in set(links))[:12])
        raise ValueError(f"{source} has no link {shown(link)}: choose one of its links ({known}, ...)")
    return serial
