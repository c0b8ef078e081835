"""How fast the bypass environments step, against robosuite's own environment and against bare physics.

    uv run python benchmarks/environments.py [--steps 600]

Everything runs on one core, in one process and in turns, with the cube grasped and held still above the table; a
row's speed is the median over the turns, so that a busy machine slows all rows alike. Ratios are what to quote.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy loads its libraries

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from dualhead_envs.bypass.demonstrator import follow, grasp_and_lift
from dualhead_envs.bypass.environment import BypassEnv
from dualhead_envs.bypass.physics_engine import mujoco
from dualhead_envs.bypass.robosuite_reference import RobosuiteReference
from dualhead_envs.bypass.simulation import SUBSTEPS, PandaSimulation

ENV_ID = "BimodalBypass-v2"
TURNS = 30
SERVO, TORQUE = "bare physics, servo model", "bare physics, torque model"
#: What each of our rows adds its work to.
PHYSICS = {"ours, joint": SERVO, "ours, position": TORQUE, "ours, pose": TORQUE, SERVO: SERVO, TORQUE: TORQUE}


def grasped(control: str) -> BypassEnv:
    """An environment under ``control`` whose robot holds the cube in the air."""
    expert = gym.make(f"dualhead_envs:{ENV_ID}", control="pose").unwrapped
    assert isinstance(expert, BypassEnv)
    expert.reset(seed=0)
    rotation = expert.simulation.rotation.copy()
    commands = follow(grasp_and_lift(expert.initial_state), expert.simulation.position.copy())
    for position, gripper in zip(commands.positions, commands.gripper, strict=True):
        expert.step(np.concatenate([position, rotation[:, 0], rotation[:, 1], [gripper]]))
    env = gym.make(f"dualhead_envs:{ENV_ID}", control=control).unwrapped
    assert isinstance(env, BypassEnv)
    env.reset(options={"state": expert.state()})
    assert env.simulation.cube_position[2] > 0.9, "the cube is in the hand"
    return env


def hold(env: BypassEnv) -> Callable[[], object]:
    """A control step of ``env`` that stays where it is."""
    simulation = env.simulation
    groups = {
        "joint": simulation.joints,
        "position": simulation.position,
        "rotation": simulation.rotation[:, :2].T.ravel(),
        "gripper": [1.0],
    }
    action = np.concatenate([groups[group] for group in env.layout.control_groups(env.control)])
    return lambda: env.step(action)


def bare(env: BypassEnv) -> Callable[[], object]:
    """A control step's worth of physics under the present controls, and nothing else."""
    simulation = env.simulation
    hold(env)()
    return lambda: mujoco.mj_step(simulation.model, simulation.data, nstep=SUBSTEPS)


def robosuites(simulation: PandaSimulation) -> dict[str, Callable[[], object]]:
    """Steps of robosuite's environment that stay where they are, and its bare physics."""
    osc = RobosuiteReference(simulation.task, "OSC_POSE")
    joint = RobosuiteReference(simulation.task, "JOINT_POSITION")
    for reference in (osc, joint):
        reference.copy_state(simulation)
    turn = Rotation.from_matrix(simulation.rotation).as_rotvec()
    goal = np.concatenate([simulation.position, turn, [1.0]])
    still = np.append(np.zeros(7), 1.0)
    physics = RobosuiteReference(simulation.task)
    physics.copy_state(simulation)
    physics.env.step(goal)
    model, data = physics.env.sim.model._model, physics.env.sim.data._data
    return {
        "robosuite OSC_POSE": lambda: osc.env.step(goal),
        "robosuite JOINT_POSITION": lambda: joint.env.step(still),
        "bare physics, robosuite's model": lambda: mujoco.mj_step(model, data, nstep=SUBSTEPS),
    }


def measure(rows: dict[str, Callable[[], object]], steps: int) -> dict[str, float]:
    """Steps per second of every row, best of the turns; a turn lets each row make its share of ``steps``."""
    share = max(steps // TURNS, 10)
    speeds: dict[str, list[float]] = {name: [] for name in rows}
    for step in rows.values():
        for _ in range(5):
            step()
    for _ in range(TURNS):
        for name, step in rows.items():
            start = time.process_time()
            for _ in range(share):
                step()
            speeds[name].append(share / (time.process_time() - start))
    return {name: max(values) for name, values in speeds.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=600, help="control steps a row (default: 600)")
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=SyntaxWarning)  # robosuite's logo
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    joint, position, pose = (grasped(control) for control in ("joint", "position", "pose"))
    reset = gym.make(f"dualhead_envs:{ENV_ID}").unwrapped
    rows: dict[str, Callable[[], object]] = {
        **robosuites(position.simulation),
        "ours, joint": hold(joint),
        SERVO: bare(grasped("joint")),
        "ours, position": hold(position),
        "ours, pose": hold(pose),
        TORQUE: bare(grasped("position")),
    }
    speeds = measure(rows, arguments.steps)
    resets = measure({"reset": reset.reset}, arguments.steps)["reset"]

    table = Table(title=f"{ENV_ID}, one core, cube grasped", title_justify="left", box=None, pad_edge=False)
    for heading in ("control step", "steps/s", "of robosuite's OSC", "of its bare physics"):
        table.add_column(heading, justify="left" if heading == "control step" else "right")
    for name, speed in speeds.items():
        table.add_row(
            name,
            f"{speed:.0f}",
            f"{speed / speeds['robosuite OSC_POSE']:.2f} x",
            f"{speed / speeds[PHYSICS[name]]:.1%}" if name in PHYSICS else "-",
        )
    console = Console()
    console.print(table)
    console.print(f"reset: {1e3 / resets:.3f} ms", highlight=False)


if __name__ == "__main__":
    main()
