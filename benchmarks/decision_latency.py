"""Time of one decision: ``uv run --group benchmarks python benchmarks/decision_latency.py [DATASET]``.

One pair of chunks (20 Euler steps, both heads, one observation) and 16 pairs, on one thread, beside the matrix products
that they contain, and beside LeRobot's ACT and Diffusion policies on the same data with their own defaults. Weights are
untrained: they do not change the work. Least CPU time of alternating runs. DATASET is a recorded split's root; without
one, six pairs of BimodalBypass-v2 are recorded.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig

from dualhead_envs.bypass.record import record_bypass
from dualhead_policy import DualheadConfig, DualheadPolicy
from dualhead_policy.quiet import quiet_libraries

ROUNDS = 60
STEPS = 20


def products(policy: DualheadPolicy, rows: int) -> Callable[[], object]:
    """The matrix products of a decision with ``rows`` pairs, alone."""
    weights = []
    for head in policy.model.head_slices:
        field = policy.model.network.field(head)
        weights += [layer.weight for layer in (field.input, *field.hidden, field.output)]
    operands = [(torch.randn(rows, weight.shape[1]), weight.T) for weight in weights]

    def multiply() -> None:
        for _ in range(STEPS):
            for left, right in operands:
                torch.mm(left, right)

    return multiply


def decide(policy: Any, batch: dict[str, torch.Tensor]) -> Callable[[], object]:
    """A decision of any LeRobot policy: its next action, nothing queued."""

    def act() -> object:
        policy.reset()
        return policy.select_action(dict(batch))

    return act


def measure(root: Path) -> None:
    """Print the table for a recorded split."""
    meta = LeRobotDatasetMetadata("local/latency", root=root)
    policy = make_policy(DualheadConfig(device="cpu", seed=0), ds_meta=meta).eval()
    assert isinstance(policy, DualheadPolicy)
    peers = {
        "LeRobot ACT": make_policy(ACTConfig(device="cpu", pretrained_backbone_weights=None), ds_meta=meta).eval(),
        "LeRobot Diffusion": make_policy(DiffusionConfig(device="cpu"), ds_meta=meta).eval(),
    }
    features = policy.config.input_features or {}
    batch = {key: torch.randn(1, *feature.shape) for key, feature in features.items()}
    actions: dict[str, Callable[[], object]] = {
        "1 pair": lambda: policy.sample(batch, 1),
        "1 pair, products alone": products(policy, 1),
        "16 pairs": lambda: policy.sample(batch, 16),
        "16 pairs, products alone": products(policy, 16),
        "select_action": decide(policy, batch),
    } | {name: decide(peer, batch) for name, peer in peers.items()}
    best = dict.fromkeys(actions, float("inf"))
    with torch.no_grad():
        for action in actions.values():
            action()
        for done in range(ROUNDS):
            for name, action in actions.items():
                if done >= 2 and name in peers:
                    continue
                start = time.process_time()
                action()
                best[name] = min(best[name], time.process_time() - start)
    for name, seconds in best.items():
        print(f"{name:26s}{1e3 * seconds:9.2f} ms")
    for pairs, wanted in (("1 pair", 5), ("16 pairs", 8)):
        ratio = best[pairs] / best[f"{pairs}, products alone"]
        print(f"{pairs}: {ratio:.1f} times its products; at most {wanted} ms wanted on a quiet core")


if __name__ == "__main__":
    torch.set_num_threads(1)
    quiet_libraries()
    if len(sys.argv) > 1:
        measure(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            recorded = record_bypass("BimodalBypass-v2", Path(folder) / "data", pairs=6, workers=1, progress=False)
            measure(recorded / "train")
