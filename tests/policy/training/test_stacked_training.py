"""Runs that train as one program draw, learn and save what each would have alone."""

from __future__ import annotations

import pytest
import torch

from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.stacked.stacked_training import StackedTraining
from dualhead_policy.training.trainer import Training

SMALL = [
    "--batch_size=32",
    "--steps=200",
    "--policy.device=cpu",
    "--policy.velocity_width=32",
    "--policy.encoder_dim=16",
]

#: Flags of the runs of one stack, by the mechanism that they exercise; what differs between runs is in the lists.
RING = {
    "independent": [["--policy.optimizer_lr=1e-3"], []],
    "shared noise, paper's network": [
        ["--policy.conditioning=concat", "--policy.preconditioning=none", f"--policy.source_noise_beta={beta}"]
        for beta in (0, 0.1)
    ],
    "consistency": [[f"--policy.consistency_weight={weight}"] for weight in (0.3, 3)],
    "oracle token, corrupted": [
        ["--policy.token=oracle", f"--policy.token_replacement_prob={probability}", "--policy.token_null_prob=0.1"]
        for probability in (0.1, 0.5)
    ],
    "window token, learned prior": [["--policy.token=window", "--policy.token_draw=learned"]] * 2,
    "anchor": [["--policy.latent=prior", "--policy.latent_dim=0"]] * 2,
    "latent prior": [["--policy.latent=prior"]] * 2,
    "latent posterior": [
        ["--policy.latent=posterior", f"--policy.kl_weight={weight}", f"--policy.free_bits={bits}"]
        for weight, bits in ((1, 0), (0.01, 0.5))
    ],
    "tight clipping": [["--policy.optimizer_grad_clip_norm=0.05"], ["--policy.optimizer_grad_clip_norm=10"]],
}
PANDA = {
    "noise through the kinematic map, consistency": [
        [
            "--policy.source_noise_beta=0",
            "--policy.source_noise_alignment=kinematic",
            f"--policy.consistency_weight={weight}",
        ]
        for weight in (0.3, 3)
    ],
    "frames, gripper, episode token": [["--policy.token=episode", "--policy.consistency_weight=1"]] * 2,
    "third head": [
        [
            "--policy.rotation_head=true",
            "--policy.consistency_weight=1",
            f"--policy.rotation_consistency_weight={weight}",
        ]
        for weight in (0.5, 1)
    ],
}


def build(data, tmp_path, flags):
    trainings = []
    for seed, own in enumerate(flags):
        places = [f"--dataset.root={data / 'train'}", f"--output_dir={tmp_path / str(seed)}", f"--seed={seed}"]
        trainings.append(Training(parse_training_config([*places, *SMALL, *own], None)))
    return trainings


def assert_stack_equals_single_runs(data, tmp_path, flags, steps):
    stack = StackedTraining(build(data, tmp_path / "stacked", flags))
    stacked_losses = [stack.update() for _ in range(steps)]
    for run, alone in enumerate(build(data, tmp_path / "alone", flags)):
        losses = [alone.update(alone.source.batch(step)) for step in range(steps)]
        together = torch.stack([step[:, run] for step in stacked_losses])
        torch.testing.assert_close(together, torch.tensor(losses), rtol=1e-5, atol=1e-6)
        theirs = stack.trainings[run].policy.state_dict()
        for name, value in alone.policy.state_dict().items():
            difference = (theirs[name].double() - value.double()).norm()
            assert difference <= 1e-5 * value.double().norm(), (name, float(difference / value.double().norm()))


@pytest.mark.parametrize("mechanism", RING)
def test_a_stacked_run_equals_its_single_run_on_the_ring(ring_data, tmp_path, mechanism):
    assert_stack_equals_single_runs(ring_data, tmp_path, RING[mechanism], 30)


@pytest.mark.parametrize("mechanism", PANDA)
def test_a_stacked_run_equals_its_single_run_on_the_robot(panda_data, tmp_path, mechanism):
    assert_stack_equals_single_runs(panda_data, tmp_path, PANDA[mechanism], 30)


@pytest.mark.slow
@pytest.mark.parametrize("mechanism", [*RING, *PANDA])
def test_a_stacked_run_equals_its_single_run_after_a_hundred_steps(ring_data, panda_data, tmp_path, mechanism):
    data = ring_data if mechanism in RING else panda_data
    assert_stack_equals_single_runs(data, tmp_path, (RING | PANDA)[mechanism], 100)


def test_a_stack_of_runs_at_different_steps_is_refused(ring_data, tmp_path):
    first, second = build(ring_data, tmp_path, [[], []])
    first.update(first.source.batch(0))
    with pytest.raises(ValueError, match=r"at steps \[0, 1\], expected one"):
        StackedTraining([first, second])


def test_bfloat16_fields_stay_near_float32(ring_data, tmp_path):
    flags = RING["consistency"]
    exact = StackedTraining(build(ring_data, tmp_path / "fp32", flags))
    coarse = StackedTraining(build(ring_data, tmp_path / "bf16", flags), precision="bf16")
    for _ in range(20):
        losses = torch.stack([exact.update(), coarse.update()])
    torch.testing.assert_close(losses[1], losses[0], rtol=2e-2, atol=0)
    assert all(parameter.dtype == torch.float32 for parameter in coarse.trainings[0].policy.parameters())
