"""Sets of demonstrations: every mode from one initial state, kept only if all succeed."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from dualhead_envs.bypass.demonstrator import (
    AMPLITUDE,
    AMPLITUDE_DEVIATION,
    Commands,
    follow,
    grasp_and_lift,
    pass_and_release,
    route_apex,
)
from dualhead_envs.bypass.environment import BypassEnv
from dualhead_envs.bypass.task import ROUTE_CENTER, ROUTE_FLATTENING

#: The modes part where two demonstrations are further apart than this (m; paper, app:prereg).
SEPARATION = 1e-5
#: States after the branch point that make up the window.
HORIZON = 16


@dataclass
class Demonstration:
    """One episode as measured: T steps, T + 1 states.

    Attributes:
        agent_pos: Observations (T + 1, 24) float32, the last one after the last step.
        environment_state: Observations (T + 1, C) float32.
        gripper: Gripper commands (T,).
        clearance: Smallest distance to the obstacle (m) on the way past it.
        apex_error: Distance (m) in the cross-section (y, z) of the window's outermost point from the commanded apex.
        overshoot: How much further out than the apex that point is (m); negative if the path stays inside.
        success: Whether the cube ended at the goal without a collision.
    """

    agent_pos: list[np.ndarray] = field(default_factory=list)
    environment_state: list[np.ndarray] = field(default_factory=list)
    gripper: list[float] = field(default_factory=list)
    clearance: float = np.inf
    apex_error: float = np.inf
    overshoot: float = -np.inf
    success: bool = False

    def positions(self) -> np.ndarray:
        """Measured positions of the grip site (T + 1, 3) in m."""
        return np.array(self.agent_pos)[:, 14:17]

    def actions(self) -> np.ndarray:
        """Dual actions (T, 17) float32: the state measured one step later, and the gripper's command.

        Joints (7), position (3), rotation (6), gripper (1).
        """
        after = np.array(self.agent_pos)[1:]
        gripper = np.array(self.gripper, dtype=np.float32)[:, None]
        return np.concatenate([after[:, :7], after[:, 14:17], after[:, 17:23], gripper], axis=1)


@dataclass
class DemonstrationSet:
    """One demonstration a mode, in the modes' order, from one initial state."""

    demonstrations: tuple[Demonstration, ...]
    branch_step: int
    amplitude: float

    @property
    def success(self) -> bool:
        """Whether all succeeded."""
        return all(demonstration.success for demonstration in self.demonstrations)


def demonstrate_modes(env: BypassEnv, seed: int) -> DemonstrationSet:
    """Every mode of ``env`` from the initial state of ``seed``; ``env`` needs ``control="pose"``."""
    observation, _ = env.reset(seed=seed)
    initial = env.initial_state
    amplitude = float(env.np_random.normal(AMPLITUDE, AMPLITUDE_DEVIATION))
    if env.demonstrated_amplitude is not None:
        amplitude *= env.demonstrated_amplitude / AMPLITUDE
    start_rotation = env.simulation.rotation.copy()
    start_position = env.simulation.position.copy()
    shared = Demonstration([observation["agent_pos"]], [observation["environment_state"]])
    shared_legs = grasp_and_lift(initial)
    modes = range(env.mode_partition.n_modes)
    commands = [
        follow([*shared_legs, *pass_and_release(env.bypass, initial, mode, amplitude)], start_position)
        for mode in modes
    ]
    branch_step = sum(leg.steps + leg.hold for leg in shared_legs)
    _execute(env, commands[0][:branch_step], start_rotation, shared)
    branch = env.state()

    demonstrations = []
    for mode in modes:
        env.reset(options={"state": branch})
        demonstration = Demonstration(list(shared.agent_pos), list(shared.environment_state), list(shared.gripper))
        _execute(env, commands[mode][branch_step:], start_rotation, demonstration, measure_clearance=True)
        apex = route_apex(env.bypass, initial, mode, amplitude)
        demonstration.apex_error, demonstration.overshoot = apex_miss(
            demonstration.positions()[branch_step + 1 : branch_step + 1 + HORIZON, 1:], apex[1:3]
        )
        demonstrations.append(demonstration)
    apart = min(
        _first_apart(first.positions(), second.positions()) for first, second in combinations(demonstrations, 2)
    )
    # Ways that never part, without a side step, branch where they were meant to.
    return DemonstrationSet(tuple(demonstrations), apart - 1 if apart else branch_step, amplitude)


def _first_apart(first: np.ndarray, second: np.ndarray) -> int:
    """The first state at which two paths (T, 3) of any lengths are further apart than :data:`SEPARATION`; 0 if none."""
    shortest = min(len(first), len(second))
    return int(np.argmax(np.linalg.norm(first[:shortest] - second[:shortest], axis=1) > SEPARATION))


def apex_miss(path: np.ndarray, apex: np.ndarray) -> tuple[float, float]:
    """How far the outermost point of ``path`` (T, 2) lies from ``apex`` (2,), and how much further out (m).

    Both are points (y, z) of the cross-section. Outermost is the largest projection on the direction of the apex in
    the cross-section as the partition sees it, without its flattening; the largest distance from an apex that lies in
    the middle and has no direction.
    """
    scale = np.array([1.0, ROUTE_FLATTENING])
    direction = (apex - ROUTE_CENTER) / scale
    radius = np.linalg.norm(direction)
    whitened = (path - ROUTE_CENTER) / scale
    reach = whitened @ (direction / radius) if radius > 0 else np.linalg.norm(whitened, axis=1)
    outermost = int(reach.argmax())
    distance = float(np.linalg.norm(path[outermost] - apex))
    return distance, float(np.copysign(distance, reach[outermost] - radius))


def _execute(
    env: BypassEnv,
    commands: Commands,
    start_rotation: np.ndarray,
    demonstration: Demonstration,
    *,
    measure_clearance: bool = False,
) -> None:
    """Run ``commands`` until they end or the episode does, and append what was measured."""
    for position, yaw, gripper in zip(commands.positions, commands.yaws, commands.gripper, strict=True):
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        rotation = turn @ start_rotation
        action = np.concatenate([position, rotation[:, 0], rotation[:, 1], [gripper]])
        observation, _, terminated, _, info = env.step(action)
        demonstration.agent_pos.append(observation["agent_pos"])
        demonstration.environment_state.append(observation["environment_state"])
        demonstration.gripper.append(float(gripper))
        if measure_clearance:
            demonstration.clearance = min(demonstration.clearance, env.simulation.clearance())
        if terminated:
            demonstration.success = info["is_success"]
            return
