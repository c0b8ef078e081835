"""The XML of a robot's description (URDF or MJCF), parsed within limits: it may come with somebody else's policy.

No document type and hence no entities, no other files, bounded size, depth and number of bodies (replications
counted), links that form one tree, finite offsets and axes.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

#: Largest description, in characters; the Panda's URDF has 12,000.
MAX_CHARACTERS = 4 * 2**20
#: Most bodies or links, each counted as often as it is replicated.
MAX_BODIES = 500
#: Deepest nesting of elements.
MAX_DEPTH = 128
#: Largest offset (m) and longest axis.
MAX_NUMBER = 1e6
#: What of an MJCF moves bodies; the rest would have to be found in other files, or refers to what is left out.
MJCF_SECTIONS = {"compiler", "option", "size", "default", "worldbody"}
MJCF_SHAPES = {"geom", "camera", "light", "skin", "flex"}
#: Elements that read other files, or make bodies of their own.
REFUSED_ELEMENTS = {"include", "composite", "flexcomp", "attach", "plugin", "model"}
NUMERIC_ATTRIBUTES = {"xyz", "rpy", "pos", "quat", "axis", "axisangle", "euler", "xyaxes", "zaxis", "offset"}
ADVICE = "give the path of the robot's URDF or MJCF file"


def parse_robot_xml(xml: str, source: Path) -> ElementTree.Element:
    """The root of a robot's description.

    Args:
        xml: The description.
        source: Where it was read, for errors.

    Raises:
        ValueError: If it is none, or exceeds a limit.
    """
    if len(xml) > MAX_CHARACTERS:
        raise ValueError(f"{source} has {len(xml)} characters, expected at most {MAX_CHARACTERS}: {ADVICE}")
    if "<!DOCTYPE" in xml or "<!ENTITY" in xml:
        raise ValueError(f"{source} declares a document type or entities, expected plain elements: write them out")
    try:
        root = ElementTree.fromstring(xml)
    except (ElementTree.ParseError, ValueError) as error:
        where = ", line {}, column {}".format(*error.position) if isinstance(error, ElementTree.ParseError) else ""
        raise ValueError(f"{source} is not XML{where}: {ADVICE}") from error
    if root.tag not in ("robot", "mujoco"):
        raise ValueError(f"{source} is XML but begins with neither <robot> (URDF) nor <mujoco> (MJCF): {ADVICE}")
    _check_depth(root, source)
    if root.tag == "mujoco":
        _reduce_mjcf(root, source)
    else:
        _check_tree(root, source)
    bodies = _bodies(root)
    if bodies > MAX_BODIES:
        raise ValueError(
            f"{source} describes {bodies} bodies, expected at most {MAX_BODIES}: leave out what is not the robot"
        )
    for element in root.iter():
        _check_numbers(element, source)
    return root


def _check_depth(root: ElementTree.Element, source: Path) -> None:
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > MAX_DEPTH:
            raise ValueError(f"{source} is nested deeper than {MAX_DEPTH} elements: {ADVICE}")


def _reduce_mjcf(root: ElementTree.Element, source: Path) -> None:
    """Leave the bodies, joints and sites: meshes and textures would have to be found and read."""
    for part in [child for child in root if child.tag not in MJCF_SECTIONS | REFUSED_ELEMENTS]:
        root.remove(part)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in REFUSED_ELEMENTS:
                raise ValueError(
                    f"{source} holds <{child.tag}>, which reads files or makes bodies of its own: write its bodies out"
                )
            if child.tag in MJCF_SHAPES or (child.tag == "body" and _floats(child)):
                parent.remove(child)
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root, "compiler")
    # MuJoCo wants every moving body to have inertia, which may have come from its geoms.
    compiler.attrib.update(boundmass="0.001", boundinertia="1e-6")


def _floats(body: ElementTree.Element) -> bool:
    """Whether a body is an object of the scene; pytorch-kinematics knows hinges and slides only."""
    free = any(joint.get("type") in ("free", "ball") for joint in body.findall("joint"))
    return free or body.find("freejoint") is not None


def _check_tree(root: ElementTree.Element, source: Path) -> None:
    """Refuse a URDF whose joints do not make one tree of its links."""
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    ends = {end: [_end(joint, end) for joint in joints] for end in ("parent", "child")}
    for names, what in ((links, "link"), ([joint.get("name", "") for joint in joints], "joint")):
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated or "" in names:
            raise ValueError(f"{source} has a {what} without a name of its own: give every {what} one")
    if not set(ends["parent"]) | set(ends["child"]) <= set(links):
        raise ValueError(f"{source} has a joint whose parent or child is no link of it: name its links")
    parent_of = dict(zip(ends["child"], ends["parent"], strict=True))
    roots = [link for link in links if link not in parent_of]
    for link in links:
        distance = 0
        while link in parent_of and distance <= len(links):
            link, distance = parent_of[link], distance + 1
        if distance > len(links):
            raise ValueError(
                f"{source} has links that are their own parents: expected a tree of links; mend its joints"
            )
    if len(parent_of) != len(joints) or len(roots) != 1:
        raise ValueError(
            f"{source} has {len(roots)} links without a parent and {len(joints) - len(parent_of)} with several, "
            "expected a tree with one root: mend its joints"
        )


def _end(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _bodies(element: ElementTree.Element, times: int = 1) -> int:
    if element.tag == "replicate":
        count = element.get("count", "")
        times *= int(count) if count.isdecimal() and len(count) < 8 else MAX_BODIES + 1
    own = times if element.tag in ("body", "link") else 0
    return own + sum(_bodies(child, times) for child in element)


def _check_numbers(element: ElementTree.Element, source: Path) -> None:
    for name in NUMERIC_ATTRIBUTES & element.attrib.keys():
        try:
            numbers = [float(token) for token in element.attrib[name].split()]
        except ValueError:
            numbers = [math.nan]
        if not all(math.isfinite(number) and abs(number) <= MAX_NUMBER for number in numbers):
            raise ValueError(
                f"{source} has an element <{element.tag}> whose {name} is not finite numbers up to {MAX_NUMBER:g}: "
                "mend it"
            )
        if (element.tag, name) in (("axis", "xyz"), ("joint", "axis")) and not any(numbers):
            raise ValueError(f"{source} has a joint whose axis is zero, expected a direction: mend it")
