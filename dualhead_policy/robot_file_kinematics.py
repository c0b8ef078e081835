"""Forward kinematics of any robot described by a URDF or MJCF file, through pytorch-kinematics.

Slower than :mod:`dualhead_policy.panda_kinematics` and not for ``vmap``; the way to bring another robot.
"""

from __future__ import annotations

import contextlib
import io
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import Tensor

#: What ``kinematic_map`` starts with when it names a file.
FILE_SCHEME = "file:"
#: Parts of an MJCF that need other files or refer to parts left out; none of them moves a body.
_UNUSED_MJCF = ("asset", "actuator", "sensor", "contact", "tendon", "equality", "keyframe")


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


def robot_file_position(kinematic_map: str, n_joints: int | None = None) -> Callable[[Tensor], Tensor]:
    """The map from joint angles to the position of a link.

    Args:
        kinematic_map: ``"file:PATH#LINK"``; the link may be an MJCF site too.
        n_joints: Joints that the chain must have; None: any number.

    Returns:
        A function from joint values (..., n), in the chain's order from its root, in rad (m for slides), to
        positions (..., 3) in m, in the frame of the file's root.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no robot description, or its chain lacks the link or has another number of joints.
    """
    path, link = parse_robot_file(kinematic_map)
    chain = _serial_chain(path, link)
    joints = len(chain.get_joint_parameter_names())
    if n_joints not in (None, joints):
        raise ValueError(
            f"{path} has {joints} joints between its root and {link!r}, the joint head predicts {n_joints}: name the "
            "link that the demonstrations' joints move"
        )

    def to_position(values: Tensor) -> Tensor:
        if values.shape[-1] != joints:
            raise ValueError(
                f"the chain to {link!r} has {joints} joints, got {values.shape[-1]}: pass joint values (..., {joints})"
            )
        moved = chain.to(dtype=values.dtype, device=values.device)
        flat = values.reshape(-1, joints)
        return moved.forward_kinematics(flat).get_matrix()[:, :3, 3].reshape(*values.shape[:-1], 3)

    return to_position


def _serial_chain(path: Path, link: str) -> Any:
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist: give the path of the robot's URDF or MJCF file")
    try:
        root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not XML ({error}): give the path of the robot's URDF or MJCF file") from error
    if root.tag not in ("robot", "mujoco"):
        raise ValueError(
            f"{path} begins with <{root.tag}>, expected <robot> (URDF) or <mujoco> (MJCF): give the path of the "
            "robot's description"
        )
    # pytorch-kinematics prints its complaints about parts of the file that it does not use.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        import pytorch_kinematics

        if root.tag == "robot":
            chain = pytorch_kinematics.build_chain_from_urdf(ElementTree.tostring(root))
        else:
            chain = pytorch_kinematics.build_chain_from_mjcf(_bare_mjcf(root))
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
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root, "compiler")
    # MuJoCo wants every moving body to have inertia, which may have come from its geoms.
    compiler.attrib.update(boundmass="0.001", boundinertia="1e-6")
    return ElementTree.tostring(root, encoding="unicode")
