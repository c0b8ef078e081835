"""The law of shared noise, on recorded demonstrations of the arm and on the ring's maps."""

from __future__ import annotations

import numpy as np
import pytest
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from dualhead_envs.dataset_frames import read_split
from dualhead_eval.effects.noise_law import demonstrated_alignment, rho_of_alignment
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.pretrained import load_policy, policy_folder


@pytest.fixture(scope="module")
def arm(panda_data):
    """An untrained policy whose scales are fitted to v2, and the demonstrations."""
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    config = DualheadConfig(device="cpu", velocity_width=32, rotation_head=True)
    return make_policy(config, ds_meta=meta).model, read_split(panda_data / "train")


def test_rho_is_that_of_two_normal_numbers_with_this_correlation():
    rng = np.random.default_rng(0)
    for a in (-0.7, 0.0, 0.4, 0.98):
        one, other = rng.normal(size=(2, 400_000))
        agree = (np.sign(one) == np.sign(a * one + np.sqrt(1 - a * a) * other)).mean()
        assert 2 * agree - 1 == pytest.approx(float(rho_of_alignment(a)), abs=0.006)


def test_the_arms_first_joints_say_nothing_about_the_side_and_the_kinematic_map_nearly_all(arm):
    by_coordinate, aligned = (demonstrated_alignment(*arm, source_noise_alignment=how) for how in (None, "kinematic"))
    assert np.abs(rho_of_alignment(by_coordinate)).max() < 0.02
    assert rho_of_alignment(aligned).min() > 0.9


def test_on_the_ring_the_alignment_is_the_maps(trained, ring_data):
    """The null-space lift's overlap is -0.35; through the map itself both heads decide alike."""
    model = load_policy(policy_folder(trained))[0].model
    frames = read_split(ring_data / "test")
    by_coordinate = demonstrated_alignment(model, frames)
    assert by_coordinate.mean() == pytest.approx(-0.35, abs=0.05)
    np.testing.assert_allclose(demonstrated_alignment(model, frames, source_noise_alignment="kinematic"), 1, atol=1e-5)


def test_demonstrations_that_are_not_pairs_are_refused(trained, ring_data):
    model = load_policy(policy_folder(trained))[0].model
    with pytest.raises(ValueError, match="every pair in two modes"):
        demonstrated_alignment(model, read_split(ring_data / "train"))


def test_a_head_that_is_not_there_is_refused(arm):
    with pytest.raises(ValueError, match="no head 'wrist'"):
        demonstrated_alignment(*arm, heads=("joint", "wrist"))
