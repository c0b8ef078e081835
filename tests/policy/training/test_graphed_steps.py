"""Steps whose inputs are drawn ahead by other processes are those that the stack makes on its own."""

from __future__ import annotations

import pytest
import torch

from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.array_store import ArrayStore
from dualhead_policy.training.stacked import draw_ahead
from dualhead_policy.training.stacked.draw_ahead import DrawAhead
from dualhead_policy.training.stacked.graphed_steps import GraphedSteps
from dualhead_policy.training.stacked.run_feed import RunFeed
from dualhead_policy.training.stacked.stacked_training import StackedTraining
from dualhead_policy.training.trainer import Training

SMALL = ["--batch_size=32", "--policy.velocity_width=32", "--policy.encoder_dim=16"]
MECHANISMS = {
    "consistency": [[f"--policy.consistency_weight={weight}"] for weight in (0.3, 3)],
    "oracle token, corrupted": [
        ["--policy.token=oracle", f"--policy.token_replacement_prob={probability}"] for probability in (0.1, 0.5)
    ],
    "window token, learned prior": [["--policy.token=window", "--policy.token_draw=learned"]] * 2,
    "latent posterior": [["--policy.latent=posterior", f"--policy.kl_weight={weight}"] for weight in (1, 0.01)],
    "two learning rates": [["--policy.optimizer_lr=1e-3"], []],
}


def build(data, output, flags, *, fresh_paths=False, steps=12, device="cpu"):
    store = ArrayStore(output / "windows")
    trainings = []
    for seed, own in enumerate(flags):
        places = [f"--dataset.root={data / 'train'}", f"--output_dir={output / str(seed)}", f"--seed={seed}"]
        budget = [f"--steps={steps}", f"--policy.device={device}"]
        cfg = parse_training_config([*places, *budget, *SMALL, *own], None)
        training = Training(cfg, fresh_paths=fresh_paths)
        training.share_windows(store)
        trainings.append(training)
    return trainings


@pytest.mark.parametrize(
    ("mechanism", "fresh_paths"), [*((name, False) for name in MECHANISMS), ("window token, learned prior", True)]
)
def test_steps_from_drawn_blocks_are_those_of_the_stack(ring_data, tmp_path, monkeypatch, mechanism, fresh_paths):
    monkeypatch.setattr(draw_ahead, "BLOCK_BYTES", 1)  # one step per block: every step takes another
    flags = MECHANISMS[mechanism]
    alone = StackedTraining(build(ring_data, tmp_path / "alone", flags, fresh_paths=fresh_paths))
    ahead = StackedTraining(build(ring_data, tmp_path / "ahead", flags, fresh_paths=fresh_paths))
    steps = GraphedSteps(ahead.trainings, ahead._model, ahead._optimizer, processes=1)
    try:
        for count in (1, 4, 7):
            losses = steps.run(count)
            for training in ahead.trainings:
                training.advance(count)
            torch.testing.assert_close(
                losses, torch.stack([alone.update() for _ in range(count)]), rtol=1e-6, atol=1e-7
            )
    finally:
        steps.close()
    for one, other in zip(alone.trainings, ahead.trainings, strict=True):
        assert one.optimizer.param_groups[0]["lr"] == other.optimizer.param_groups[0]["lr"]
        for name, value in one.policy.state_dict().items():
            torch.testing.assert_close(other.policy.state_dict()[name], value, rtol=1e-5, atol=1e-7)


def test_blocks_hold_what_each_run_draws(ring_data, tmp_path):
    feeds = [RunFeed.of(training) for training in build(ring_data, tmp_path, [[], [], []])]
    ahead = DrawAhead(feeds, 3, 12, processes=2)
    try:
        block = ahead.block(0)
        for offset in range(min(9, ahead.layout.steps)):
            for run, feed in enumerate(feeds):
                for name, value in feed.inputs(3 + offset).items():
                    assert torch.equal(block[name][offset, run, : len(value)], value), (name, offset, run)
        del block
    finally:
        ahead.close()


@pytest.mark.cuda
@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_recorded_steps_on_cuda_learn_what_a_cpu_learns(ring_data, tmp_path, mechanism):
    assert torch.cuda.is_available(), (
        "LeRobot takes the CPU where there is no GPU, and the comparison would be with itself"
    )
    flags = MECHANISMS[mechanism]
    host = StackedTraining(build(ring_data, tmp_path / "cpu", flags, steps=40))
    device = StackedTraining(build(ring_data, tmp_path / "cuda", flags, steps=40, device="cuda"))
    try:
        theirs = torch.cat([device.updates(count) for count in (1, 29)]).cpu()
    finally:
        device.close()
    torch.testing.assert_close(theirs, host.updates(30), rtol=1e-4, atol=1e-5)


@pytest.mark.cuda
@pytest.mark.parametrize("representation", ["nullspace", "polar"])
def test_a_ring_policy_trains_on_cuda_and_opens_there_again(tmp_path, representation):
    from dualhead_envs.record import record
    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.samplers import open_policy
    from dualhead_policy.sampling import SamplingCoupling
    from dualhead_policy.training.sweep.run_sweep import run_sweep
    from dualhead_policy.training.sweep.sweep_file import SweepRun

    assert torch.cuda.is_available(), "this needs an NVIDIA GPU"
    sizes = {"episodes": 60, "conditions": 2, "env_kwargs": {"representation": representation}, "progress": False}
    data = record("RotatingRing-v2", tmp_path / "data", **sizes)
    flags = ["--policy.consistency_weight=3", "--policy.device=cuda", *SMALL, "--steps=4", "--save_freq=4"]
    runs = [
        SweepRun(f"ring/G/seed-{seed}", str(data / "train"), seed, (f"--dataset.root={data / 'train'}", *flags))
        for seed in (0, 1)
    ]
    run_sweep(runs, tmp_path / "runs", jobs=1, size=2, precision="fp32", show_progress=False)
    conditions, policy = open_conditions(data / "test"), tmp_path / "runs" / "ring" / "G" / "seed-1"
    sampled = [
        open_policy(policy, device=device).sample(conditions, 3, 20, SamplingCoupling(), seed=0)
        for device in ("cpu", "cuda")
    ]
    torch.testing.assert_close(sampled[1].joint.cpu(), sampled[0].joint, rtol=1e-4, atol=1e-4)
