"""Robot descriptions that would never end, lead elsewhere or mean nothing are refused before they are built."""

from __future__ import annotations

import pytest

from dualhead_policy.kinematics.kinematic_map import KinematicMap

LINKS = '<link name="a"/><link name="b"/><link name="c"/>'


def joint(parent, child, name="", inside=""):
    return (
        f'<joint name="{name or parent + child}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def urdf(*joints, links=LINKS):
    return f'<robot name="r">{links}{"".join(joints)}</robot>'


def mjcf(bodies, sections=""):
    return f"<mujoco>{sections}<worldbody>{bodies}</worldbody></mujoco>"


BODY = '<body name="b"><joint name="j" axis="{axis}"/><site name="c" pos="{pos}"/></body>'
REFUSED = {
    "entities": ('<!DOCTYPE robot [<!ENTITY a "aaaa">]><robot name="&a;"/>', "document type"),
    "an external entity": ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot>&x;</robot>', "entities"),
    "a cycle": (urdf(joint("a", "b"), joint("b", "a"), joint("a", "c")), "its own parents|with several|own parents"),
    "a cycle beside a tree": (urdf(joint("a", "a"), joint("b", "c")), "own parents"),
    "two parents": (urdf(joint("a", "c"), joint("b", "c")), "expected a tree"),
    "two roots": (urdf(joint("a", "c")), "2 links without a parent"),
    "no link of a joint": (urdf(joint("a", "z")), "no link of it"),
    "a name given twice": (urdf(joint("a", "b"), links=LINKS + '<link name="a"/>'), "a name of its own"),
    "an infinite origin": (urdf(joint("a", "b", inside='<origin xyz="inf 0 0"/>'), joint("b", "c")), "not finite"),
    "an origin of words": (urdf(joint("a", "b", inside='<origin xyz="x y z"/>'), joint("b", "c")), "not finite"),
    "a zero axis": (urdf(joint("a", "b", inside='<axis xyz="0 0 0"/>'), joint("b", "c")), "axis is zero"),
    "a zero axis in MJCF": (mjcf(BODY.format(axis="0 0 0", pos="0 0 0")), "axis is zero"),
    "a site that is nowhere": (mjcf(BODY.format(axis="0 0 1", pos="nan 0 0")), "not finite"),
    "an included file": (mjcf('<include file="/etc/hostname"/>'), "<include>"),
    "endless replication": (mjcf('<replicate count="999999"><body name="b"/></replicate>'), "bodies, expected at most"),
    "nested replication": (
        mjcf('<replicate count="100">' * 3 + '<body name="b"/>' + "</replicate>" * 3),
        "1000000 bodies",
    ),
    "too many bodies": (mjcf("".join(f'<body name="b{i}"/>' for i in range(600))), "600 bodies"),
    "endless depth": (mjcf("<body>" * 50_000 + "</body>" * 50_000), "nested deeper"),
    "too long a text": (urdf(joint("a", "b"), links=LINKS + " " * 5_000_000), "characters"),
    "a composite": (mjcf('<body name="b"><composite type="cable" count="100000 1 1"/></body>'), "<composite>"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_description_is_refused_with(what, tmp_path):
    xml, sentence = REFUSED[what]
    path = tmp_path / "robot.xml"
    path.write_text(xml)
    with pytest.raises(ValueError, match=sentence) as refusal:
        KinematicMap(f"file:{path}#c").require()
    assert str(refusal.value).isprintable()


def test_replicated_bodies_within_the_limit_are_a_robot(tmp_path):
    path = tmp_path / "robot.xml"
    arm = '<body name="arm"><joint name="a"/><geom size=".1"/><site name="tip" pos="1 0 0"/></body>'
    path.write_text(mjcf(arm + '<replicate count="3" offset="0 1 0"><body name="peg"/></replicate>'))
    assert KinematicMap(f"file:{path}#tip").require()
