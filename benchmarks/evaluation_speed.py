"""The frozen protocol beside its matrix products: ``uv run python benchmarks/evaluation_speed.py``.

96,000 samples of both heads (75 conditions, 1280 pairs, 20 Euler steps) of a BimodalBypass-v2 policy, from raw
observations to the gate, against the velocity fields' matrix products alone, in blocks of as many rows as a condition
has pairs: the least CPU time on one thread of rounds that alternate. The conditions are those of a small recording,
repeated; neither they nor what the policy has learnt enters the time. ``--policy DIR`` takes a policy of yours.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from dualhead_envs.bypass.record import record_bypass
from dualhead_eval.evaluation.conditions import ConditionBank, open_conditions
from dualhead_eval.evaluation.open_loop import evaluate
from dualhead_eval.evaluation.protocol import FROZEN_NFE, FROZEN_PAIRS, EvaluationProtocol
from dualhead_eval.evaluation.samplers import open_policy
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.quiet import quiet_libraries
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training

CONDITIONS = 75


def repeated(conditions: ConditionBank, count: int) -> ConditionBank:
    """A bank of ``count`` conditions, those of ``conditions`` over and over."""
    rows = np.arange(count) % len(conditions)
    return replace(
        conditions,
        observation={key: value[rows] for key, value in conditions.observation.items()},
        pair_ids=np.arange(count),
        direction=None if conditions.direction is None else conditions.direction[rows],
    )


def field_layers(model: DualheadModel) -> list[nn.Linear]:
    """Layers that every noisy chunk passes at every step."""
    fields = [model.network.field(head) for head in model.head_dims]
    return [layer for field in fields for layer in (field.input, *field.hidden, field.output)]


def matrix_products(layers: list[nn.Linear]) -> None:
    """The products of all samples at all steps, and nothing else."""
    for layer in layers:
        x = torch.randn(FROZEN_PAIRS, layer.in_features)
        weight, out = layer.weight.detach().T, torch.empty(FROZEN_PAIRS, layer.out_features)
        for _ in range(CONDITIONS * FROZEN_NFE):
            torch.mm(x, weight, out=out)


def train_briefly(data: Path, output: Path, mechanism: list[str]) -> Path:
    """A v2 policy after 20 steps."""
    flags = [f"--dataset.root={data / 'train'}", f"--output_dir={output}", "--policy.device=cpu", "--steps=20"]
    return Training(parse_training_config([*flags, *mechanism], None)).run()


def main() -> None:
    """Print the times and their ratio, for a policy without and one with tokens."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", type=Path, help="folder of a BimodalBypass-v2 policy (default: train two briefly)")
    parser.add_argument("--rounds", type=int, default=2)
    args = parser.parse_args()
    quiet_libraries()
    with tempfile.TemporaryDirectory() as folder:
        data = record_bypass("BimodalBypass-v2", Path(folder) / "data", pairs=6, workers=1, progress=False)
        conditions = repeated(open_conditions(data / "test"), CONDITIONS)
        policies = {"given": args.policy}
        if args.policy is None:
            mechanisms = {"independent": [], "oracle token": ["--policy.token=oracle"]}
            policies = {name: train_briefly(data, Path(folder) / name, flags) for name, flags in mechanisms.items()}
        for name, path in policies.items():
            sampler = open_policy(path)
            assert isinstance(sampler.sampler, DualheadPolicy)
            layers = field_layers(sampler.sampler.model)
            products, protocol = float("inf"), float("inf")
            for _ in range(args.rounds):
                start = time.process_time()
                matrix_products(layers)
                middle = time.process_time()
                evaluate(sampler, conditions, EvaluationProtocol(), name)
                products = min(products, middle - start)
                protocol = min(protocol, time.process_time() - middle)
            operations = 2 * CONDITIONS * FROZEN_PAIRS * FROZEN_NFE * sum(layer.weight.numel() for layer in layers)
            print(
                f"{name}: products {products:.1f} s ({operations / products / 1e9:.0f} GFLOP/s), frozen protocol "
                f"{protocol:.1f} s, ratio {protocol / products:.2f}, at most 1.5 wanted"
            )


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
