"""Any Gymnasium environment with a partition."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate.wrapper import CertificateWrapper
from dualhead_eval.partitions.side import SidePartition
from dualhead_eval.partitions.wrapper import ModePartitionWrapper

#: The side to which a cart has gone, 5 cm from where it started.
SIDES = SidePartition([1.0], tau=0.05)


def make_cart(**options):
    return ModePartitionWrapper(gym.make("CartPole-v1"), SIDES, lambda observation: observation[:1], **options)


@pytest.mark.parametrize(("action", "mode"), [(1, 0), (0, 1)])
def test_info_says_the_mode_of_the_path_since_the_reset(action, mode):
    env = make_cart()
    _, info = env.reset(seed=0)
    modes, done = [info["mode"]], False
    while not done:
        *_, terminated, truncated, info = env.step(action)
        modes.append(info["mode"])
        done = terminated or truncated
    assert modes[0] == -1
    assert modes[-1] == mode
    assert env.reset(seed=0)[1]["mode"] == -1


def test_the_environment_is_left_as_it_is():
    env = make_cart()
    assert not hasattr(env.unwrapped, "mode_partition")
    assert type(env.unwrapped) is type(gym.make("CartPole-v1").unwrapped)
    check_env(env, skip_render_check=True)


def test_the_certificate_labels_with_the_wrappers_partition_and_condition():
    seen = []

    class Recorded(SidePartition):
        def score(self, path, condition=()):
            seen.append(np.shape(condition))
            return super().score(path, condition)

    env = ModePartitionWrapper(
        gym.make("CartPole-v1"), Recorded([1.0], tau=0.05), lambda o: o[:1], condition=lambda o: o[2:]
    )
    rng = np.random.default_rng(0)

    def predict(observation):
        side = rng.choice([-1.0, 1.0], size=(16, 1, 1))
        return side * np.linspace(0, 1, 8)[:, None], side * np.linspace(0, 0.5, 8)[:, None]

    certificate = CoordinationCertificate(margin=0.10)
    env = CertificateWrapper(env, predict, certificate, decision_interval=10)
    for episode in range(150):
        _, info = env.reset(seed=episode)
    assert info["coordination"]["verdict"] == "coordinated"
    assert info["mode"] == -1
    assert set(seen) == {(2,)}


def test_a_position_that_is_no_point_is_refused():
    env = ModePartitionWrapper(gym.make("CartPole-v1"), SIDES, lambda observation: observation[0])
    with pytest.raises(ValueError, match=r"expected a finite point"):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="no mode partition"):
        ModePartitionWrapper(gym.make("CartPole-v1"), object(), lambda observation: observation)
