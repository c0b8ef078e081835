"""The kinds of perturbation, and a perturbation as a user names it: ``KIND:SEVERITY`` or ``KIND@LEVEL``."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dualhead_envs.bypass.perturbations.acting import Delay, Push, Slip
from dualhead_envs.bypass.perturbations.effect import Effect
from dualhead_envs.bypass.perturbations.levels import LEVELS
from dualhead_envs.bypass.perturbations.scene import Friction, MovedGoal, MovedObstacle, Payload
from dualhead_envs.bypass.perturbations.sensing import CubeBias, JointBias, Noise


@dataclass(frozen=True)
class Kind:
    """One kind of perturbation.

    Attributes:
        effect: What it does.
        unit: Unit of its severity.
        least, most: Severities that make sense, inclusive.
        meaning: What happens, and in brackets how the policy's heads see it.
        whole: Whether a severity is a number of control steps.
    """

    effect: type[Effect]
    unit: str
    least: float
    most: float
    meaning: str
    whole: bool = False


KINDS = {
    "cube_bias": Kind(CubeBias, "m", 1e-4, 0.2, "the cube is seen beside where it is (plausible)"),
    "joint_bias": Kind(
        JointBias,
        "rad",
        1e-4,
        1.0,
        "joint encoders are off by a vector of this norm, the grip site is not (contradiction)",
    ),
    "noise": Kind(
        Noise, "rad", 1e-4, 1.0, "white noise on joints, and of half as many metres on grip site and cube (visible)"
    ),
    "push": Kind(Push, "N", 1.0, 1000.0, "a horizontal force on the hand for 0.3 s, cube in hand (visible afterwards)"),
    "slip": Kind(Slip, "steps", 1, 100, "the gripper opens on the way (visible afterwards)", whole=True),
    "delay": Kind(Delay, "steps", 1, 40, "actions are executed late (visible)", whole=True),
    "payload": Kind(Payload, "1", 0.1, 100.0, "the cube's mass, times this (visible afterwards)"),
    "friction": Kind(Friction, "1", 0.01, 10.0, "friction of cube and fingers, times this (visible afterwards)"),
    "obstacle": Kind(MovedObstacle, "m", 1e-4, 0.3, "the obstacle is moved, and reported where it was (never visible)"),
    "goal": Kind(MovedGoal, "m", 1e-4, 0.3, "the goal is moved, and reported (visible, outside what was trained)"),
}


@dataclass(frozen=True)
class Perturbation:
    """A kind and a severity in its unit."""

    kind: str
    severity: float

    def __str__(self) -> str:
        return f"{self.kind}:{self.severity:.6g}"

    def effect(self) -> Effect:
        """A fresh effect of this kind and severity."""
        return KINDS[self.kind].effect(self.severity)


def parse_perturbation(text: str, env_id: str) -> Perturbation:
    """The perturbation that ``text`` names: ``KIND:SEVERITY`` or, with the levels of ``env_id``, ``KIND@LEVEL``.

    >>> parse_perturbation("joint_bias:0.06", "BimodalBypass-v2")
    Perturbation(kind='joint_bias', severity=0.06)

    Raises:
        ValueError: If the text names no kind, severity or level, or one that makes no sense.
    """
    form = f"give KIND:SEVERITY, for example joint_bias:0.06, or KIND@LEVEL with a level of 1 to {_N_LEVELS}"
    if not isinstance(text, str):
        raise ValueError(f"perturbation={text!r} is not text: {form}")
    separator = "@" if "@" in text else ":"
    kind, _, number = text.partition(separator)
    if kind not in KINDS:
        raise ValueError(f"perturbation={text!r} is of no known kind, expected one of {', '.join(KINDS)}: {form}")
    if separator == "@":
        if number not in map(str, range(1, _N_LEVELS + 1)):
            raise ValueError(f"perturbation={text!r} has the level {number!r}, expected 1 to {_N_LEVELS}: {form}")
        return Perturbation(kind, LEVELS[env_id][kind][int(number) - 1])
    about = KINDS[kind]
    try:
        severity = float(number)
    except ValueError:
        raise ValueError(f"perturbation={text!r} has the severity {number!r}, which is no number: {form}") from None
    if not (math.isfinite(severity) and about.least <= severity <= about.most):
        raise ValueError(
            f"perturbation={text!r} has the severity {number}, expected {about.least:g} to {about.most:g} "
            f"({about.unit}): choose one in this range"
        )
    if about.whole and severity != round(severity):
        raise ValueError(f"perturbation={text!r} has the severity {number}, expected a whole number of control steps")
    return Perturbation(kind, severity)


_N_LEVELS = 4
