"""The certificate beside a real rollout of the ring."""

import gymnasium as gym
import numpy as np
import pytest

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate.reading import VERDICTS
from dualhead_eval.certificate.wrapper import CERTIFICATE_FEATURES, CertificateWrapper, certificate_columns


def ring_paths(condition, modes):
    """Clean paths (n, 16, 2) toward the given modes of a two-mode ring."""
    cos, sin, radius = np.asarray(condition, dtype=float)
    angle = np.arctan2(sin, cos) + np.pi * modes
    rise = np.sin(np.pi * np.arange(16) / 15)
    return radius * rise[None, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]


def predictor(couple, seed=0, n=4):
    rng = np.random.default_rng(seed)

    def predict(observation):
        a, own = rng.integers(0, 2, size=(2, n))
        b = np.where(rng.random(n) < couple, a, own)
        return tuple(ring_paths(observation["environment_state"], modes) for modes in (a, b))

    return predict


def make(couple, **kwargs):
    env = gym.make("dualhead_envs:RotatingRing-v2", representation="nullspace", control="position")
    return CertificateWrapper(env, predictor(couple), **kwargs)


@pytest.mark.parametrize(("couple", "verdict", "episodes"), [(1.0, "coordinated", 250), (0.0, "uncoordinated", 3000)])
def test_the_verdict_of_a_rollout_reaches_info(couple, verdict, episodes):
    env = make(couple, decision_interval=16, certificate=CoordinationCertificate(margin=0.10))
    for episode in range(episodes):
        _, info = env.reset(seed=episode)
        if info["coordination"]["verdict"] == verdict:
            break
    assert info["coordination"]["verdict"] == verdict
    assert info["coordination"]["kind"] == "conditional"
    assert info["coordination"]["valid_rate"] == 1


def test_pairs_that_follow_a_held_token_do_not_reach_the_certificate():
    """The first pair follows the episode's token, whose mode it repeats at every decision."""
    env = make(1.0, decision_interval=16, held_pairs=1)
    fresh = env._predict

    def predict(observation):
        held = ring_paths(observation["environment_state"], np.zeros(1))
        return tuple(np.concatenate([held, paths]) for paths in fresh(observation))

    env._predict = predict
    for episode in range(400):
        env.reset(seed=episode)
    reading = env.certificate.reading
    assert reading.decisions == 400
    assert env.certificate._state.pairs == 1600
    assert reading.diversity_q == pytest.approx(0.5, abs=0.06)
    env._held = 5
    with pytest.raises(ValueError, match="fresh pairs"):
        env.reset(seed=0)


def test_a_single_pair_per_decision_is_not_stored_as_coordinated():
    env = gym.make("dualhead_envs:RotatingRing-v2", representation="nullspace", control="position")
    env = CertificateWrapper(env, predictor(1.0, n=1), decision_interval=16)
    for episode in range(400):
        _, info = env.reset(seed=episode)
    assert info["coordination"]["delta"] > 0.4
    assert info["coordination"]["kind"] == "pooled"
    assert "Simpson" in info["coordination"]["reason"]
    assert VERDICTS[certificate_columns(info)["certificate.verdict"][0]] == "insufficient"


def test_decisions_come_at_their_interval_and_stop_with_the_episode():
    env = make(1.0, decision_interval=8)
    _, info = env.reset(seed=0)
    decisions = [info["coordination"]["decision"]]
    done = False
    while not done:
        *_, terminated, truncated, info = env.step(env.action_space.sample() * 0)
        done = terminated or truncated
        decisions.append(info["coordination"]["decision"])
    assert np.flatnonzero(decisions).tolist() == [0, 8]
    assert env.certificate.reading.decisions == 2


def test_the_residual_and_verdict_become_dataset_columns():
    env = make(0.0)
    _, info = env.reset(seed=0)
    columns = certificate_columns(info)
    assert set(columns) == set(CERTIFICATE_FEATURES)
    for name, feature in CERTIFICATE_FEATURES.items():
        assert columns[name].shape == feature["shape"]
        assert columns[name].dtype == feature["dtype"]
    assert VERDICTS[columns["certificate.verdict"][0]] == info["coordination"]["verdict"]


def test_environments_and_certificates_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="mode_partition"):
        CertificateWrapper(gym.make("CartPole-v1"), predictor(0))
    with pytest.raises(ValueError, match="modes"):
        make(0, certificate=CoordinationCertificate(n_modes=4))
    with pytest.raises(ValueError, match="decision_interval"):
        make(0, decision_interval=0)
    with pytest.raises(ValueError, match="held_pairs"):
        make(0, held_pairs=-1)
    env = make(0)
    env._predict = lambda observation: (np.zeros((4, 16)), np.zeros((4, 16)))
    with pytest.raises(ValueError, match=r"\(n, H, d\)"):
        env.reset(seed=0)
