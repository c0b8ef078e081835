"""Cost of kinematics and consistency: ``uv run python benchmarks/policy.py``.

Two ratios, each from alternating runs of which the one of least CPU time counts, on one thread: the built-in Panda
kinematics against pytorch-kinematics (forward and backward of 2048 poses), and a training step with endpoint
consistency against one without (BimodalBypass-v2, batch 128).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from importlib.metadata import distribution
from pathlib import Path

import torch

from dualhead_envs.bypass.record import record_bypass
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.quiet import quiet_libraries
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training

ROBOT_FILE = Path(str(distribution("robosuite").locate_file("robosuite"))) / "models/assets/robots/panda/robot.xml"
POSES = 2048


def alternate(actions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Least CPU time in seconds of each action, run in turns."""
    best = dict.fromkeys(actions, float("inf"))
    for _ in range(rounds):
        for name, action in actions.items():
            start = time.process_time()
            action()
            best[name] = min(best[name], time.process_time() - start)
    return best


def kinematics() -> None:
    """Print the time of forward and backward kinematics, ours and pytorch-kinematics'."""
    joints = torch.rand(POSES, 7, generator=torch.Generator().manual_seed(0)).requires_grad_()
    maps = {
        "built in": KinematicMap("panda").position,
        "pytorch-kinematics": KinematicMap(f"file:{ROBOT_FILE}#right_hand").position,
    }

    def differentiate(name: str) -> Callable[[], object]:
        return lambda: maps[name](joints).square().sum().backward()

    best = alternate({name: differentiate(name) for name in maps}, rounds=20)
    for name, seconds in best.items():
        print(f"{name:20s}{1e3 * seconds:8.2f} ms")
    print(f"ratio {best['pytorch-kinematics'] / best['built in']:.1f}, at least 4 wanted\n")


def consistency() -> None:
    """Print the time of a training step with and without endpoint consistency."""
    quiet_libraries()
    mechanisms = {
        "independent": [],
        "consistency": ["--policy.consistency_weight=3", "--policy.source_noise_beta=0"],
    }
    with tempfile.TemporaryDirectory() as folder:
        data = record_bypass("BimodalBypass-v2", Path(folder) / "data", pairs=6, workers=1, progress=False)
        steps = {}
        for name, more in mechanisms.items():
            flags = [f"--dataset.root={data / 'train'}", f"--output_dir={folder}/{name}", "--policy.device=cpu", *more]
            training = Training(parse_training_config(flags, None))
            batches = [training.source.batch(i) for i in range(10)]
            steps[name] = lambda training=training, batches=batches: [training.update(batch) for batch in batches]
        best = alternate(steps, rounds=12)
    for name, seconds in best.items():
        print(f"{name:20s}{100 * seconds:8.2f} ms a step")
    print(f"consistency adds {best['consistency'] / best['independent'] - 1:.0%}, less than 60 % wanted")


if __name__ == "__main__":
    torch.set_num_threads(1)
    print(f"kinematics, forward and backward of {POSES} poses")
    kinematics()
    print("training step, batch 128")
    consistency()
