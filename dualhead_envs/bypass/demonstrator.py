"""The scripted expert: grasp, lift, go past the obstacle by the given mode, drop at the goal.

It commands absolute poses along minimum-jerk segments; what a policy learns from is not the commands but the measured
states. The demonstrations from one initial state share everything up to the branch, which is the lift pose:
conditions differ there, because the cube's do.

Lengths are in control steps (20 Hz), places in metres in the world frame, yaw in rad from the start's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualhead_envs.bypass.controllers import ROBOSUITE_STIFFNESS
from dualhead_envs.bypass.initial_state import InitialState
from dualhead_envs.bypass.simulation import CONTROL_PERIOD
from dualhead_envs.bypass.task import ROUTE_CENTER, ROUTE_FLATTENING, ROUTE_YAW, BypassTask

OPEN, CLOSED = -1.0, 1.0
#: Lateral amplitude of v2's routes (m): mean and standard deviation over pairs. The mean sets the paper's gap of
#: 143.7 mm within the window, the deviation its spread.
AMPLITUDE, AMPLITUDE_DEVIATION = 0.1695, 0.0008

#: Steps of v3's way out and of the rest at its end, and the damping ratio of the hand there. An under-damped hand runs
#: past the apex, outward, by about 4 mm, in proportion to how far it came; the steps then set the gap of 162 mm (paper,
#: app:prereg). Everything else is approached with critical damping.
_ROUTE_STEPS, _ROUTE_HOLD, _ROUTE_DAMPING = 8, 7, 0.83

_ABOVE_CUBE, _AT_CUBE, _LIFTED = 0.9215, 0.8215, 0.955
_OUT_X = -0.10
#: Back in the middle, above the obstacle's top; the hand, 204 mm wide along x, goes down further out.
_CARRY_Z = 1.04
_BEHIND = (0.205, 0.0, 1.04)
_ABOVE_RELEASE = (0.226, 0.0, 1.005)
_RELEASE = (0.226, 0.0, 0.930)
#: A vertical hand reaches 0.80 m from the base's axis at x = -0.56. There the arm is stretched, and one that arrives
#: with speed swings through to its elbow's limit (measured): targets stay within 0.765 m, but for the last, slow legs.
_BASE_X, _REACH = -0.56, 0.765


@dataclass(frozen=True)
class Leg:
    """One segment: to ``position`` (3,) and ``yaw`` in ``steps``, then ``hold`` steps there.

    ``damping`` is the hand's damping ratio on the way: 1 arrives without overshoot, less runs past the end and returns.
    """

    position: tuple[float, float, float]
    yaw: float
    steps: int
    hold: int
    gripper: float
    damping: float = 1.0


@dataclass(frozen=True)
class Commands:
    """What the expert commands: positions (T, 3), yaws (T,), gripper (T,)."""

    positions: np.ndarray
    yaws: np.ndarray
    gripper: np.ndarray

    def __getitem__(self, steps: slice) -> Commands:
        return Commands(self.positions[steps], self.yaws[steps], self.gripper[steps])


def minimum_jerk(steps: int) -> np.ndarray:
    """Fractions (steps,) of a segment that starts and ends at rest: 10 s^3 - 15 s^4 + 6 s^5, s = 1/steps .. 1."""
    s = np.arange(1, steps + 1) / max(steps, 1)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def follow(legs: Sequence[Leg], position: np.ndarray) -> Commands:
    """The commands of ``legs``, one after the other, from rest at ``position`` (3,) and yaw 0, made smooth."""
    place = np.append(position, 0.0)
    places, gripper, damping = [], [], []
    for leg in legs:
        share = np.concatenate([minimum_jerk(leg.steps), np.ones(leg.hold)])[:, None]
        target = np.append(leg.position, leg.yaw)
        places.append(place + share * (target - place))
        gripper.append(np.full(len(share), leg.gripper))
        damping.append(np.full(len(share), leg.damping))
        place = target
    smooth = damped(np.concatenate(places), np.append(position, 0.0), np.concatenate(damping))
    return Commands(smooth[:, :3], smooth[:, 3], np.concatenate(gripper))


def damped(goals: np.ndarray, start: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """A point that is drawn to each of ``goals`` (T, d) for one control step, at the end of that step.

    It obeys x'' = w^2 (goal - x) - 2 zeta w x' from rest at ``start`` (d,), integrated exactly, with zeta in (0, 1] the
    step's entry of ``damping`` (T,). This is how a hand under robosuite's default gain follows jumping goals; commanded
    as a path, it rounds off the corners between legs.
    """
    w, dt = np.sqrt(ROBOSUITE_STIFFNESS), CONTROL_PERIOD
    point, velocity = start, np.zeros_like(start)
    path = []
    for goal, zeta in zip(goals, damping, strict=True):
        ringing = w * np.sqrt(1.0 - zeta**2)
        cosine, sine = np.cos(ringing * dt), dt * np.sinc(ringing * dt / np.pi)  # sin(x dt) / x, which is dt at x = 0
        decay = np.exp(-zeta * w * dt)
        offset = point - goal
        slope = velocity + zeta * w * offset
        swing = offset * cosine + slope * sine
        point = goal + swing * decay
        velocity = (slope * cosine - ringing**2 * sine * offset - zeta * w * swing) * decay
        path.append(point)
    return np.array(path)


def grasp_and_lift(initial: InitialState) -> list[Leg]:
    """From the start to the lift pose, where the modes part."""
    x, y = initial.cube_x, initial.cube_y
    return [
        Leg((x, y, _ABOVE_CUBE), 0.0, 24, 0, OPEN),
        Leg((x, y, _AT_CUBE), 0.0, 18, 4, OPEN),
        Leg((x, y, _AT_CUBE), 0.0, 0, 12, CLOSED),
        Leg((x, y, _LIFTED), 0.0, 20, 6, CLOSED),
    ]


def route_azimuth(initial: InitialState, mode: int) -> float:
    """Azimuth psi of v3's mode 0 or 1 in rad: phi, phi + pi/2."""
    return initial.phi + 0.5 * np.pi * mode


def route_apex(task: BypassTask, initial: InitialState, mode: int, amplitude: float) -> np.ndarray:
    """Where the route of ``mode`` passes the obstacle, before it: (x, y, z) in m, and the yaw there, (4,).

    v2's mode 2 goes over the wall: as far up as the others go aside, in the units of the flattened cross-section.
    """
    if task.route_radius is None:
        if mode == 2:
            return np.array([_OUT_X, ROUTE_CENTER[0], ROUTE_CENTER[1] + ROUTE_FLATTENING * amplitude, 0.0])
        return np.array([_OUT_X, amplitude * (1.0 - 2.0 * mode), _LIFTED, 0.0])
    psi, radius = route_azimuth(initial, mode), initial.route_radius
    y = ROUTE_CENTER[0] + radius * np.cos(psi)
    z = ROUTE_CENTER[1] + ROUTE_FLATTENING * radius * np.sin(psi)
    return np.array([_OUT_X, y, z, ROUTE_YAW * np.cos(psi)])


def pass_and_release(task: BypassTask, initial: InitialState, mode: int, amplitude: float) -> list[Leg]:
    """From the lift pose past the obstacle by ``mode``, behind it, back to the middle, down, and let go."""
    _, y, z, yaw = route_apex(task, initial, mode, amplitude)
    if task.route_radius is None:
        legs = [Leg((_OUT_X, y, z), yaw, 14, 0, CLOSED)]
    else:
        legs = [Leg((_OUT_X, y, z), yaw, _ROUTE_STEPS, _ROUTE_HOLD, CLOSED, _ROUTE_DAMPING)]
    beside = min(_BEHIND[0], _BASE_X + float(np.sqrt(_REACH**2 - y**2)))
    legs.append(Leg((beside, y, max(z, _CARRY_Z)), yaw, 24, 2, CLOSED))
    return [
        *legs,
        Leg(_BEHIND, 0.0, 20, 0, CLOSED),
        Leg(_ABOVE_RELEASE, 0.0, 12, 0, CLOSED),
        Leg(_RELEASE, 0.0, 12, 6, CLOSED),
        Leg(_RELEASE, 0.0, 0, 24, OPEN),
    ]
