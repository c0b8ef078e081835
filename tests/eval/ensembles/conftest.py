"""Three members trained briefly on one ring: two without a token, and one that follows the oracle token."""

import pytest


@pytest.fixture(scope="session")
def members(ring_data, trained, tmp_path_factory):
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.trainer import Training

    root = tmp_path_factory.mktemp("members")
    paths = []
    for seed in (0, 1):
        paths.append(root / f"seed-{seed}")
        flags = [f"--dataset.root={ring_data / 'train'}", f"--output_dir={paths[-1]}", f"--seed={seed}"]
        flags += ["--steps=80", "--batch_size=64", "--policy.device=cpu", "--policy.velocity_width=64"]
        Training(parse_training_config(flags, None)).run()
    return [*paths, trained]
