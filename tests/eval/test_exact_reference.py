"""The exact reference: its velocity is the optimum, and its coordination is what theory says."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import stats

from dualhead_envs.ring.generator import RingGenerator, envelope
from dualhead_envs.ring.maps import REPRESENTATION_MAPS
from dualhead_envs.ring.partition import RingPartition
from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import both_valid, joint_counts
from dualhead_eval.exact_reference import ExactReference, _moment_table
from dualhead_eval.statistics.run_summary import summarise_table
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.sampling import SamplingCoupling

CONDITIONS = RingGenerator(2).draw_conditions(np.random.default_rng(20260802), 75)


def batch(conditions):
    return {"observation.environment_state": torch.from_numpy(conditions).float()}


def table(reference, n_modes=2, *, pairs=1280, conditions=CONDITIONS, nfe=20, **coupling):
    samples = reference.sample(
        batch(conditions), pairs, num_steps=nfe, coupling=SamplingCoupling(**coupling), generator=keyed_generator(0)
    )
    partition = RingPartition(n_modes, reference.generator.angles)
    paths = reference.map.to_position(samples.joint.double().numpy()), samples.position.double().numpy()
    return joint_counts(*(partition.assign(path, conditions[:, None]) for path in paths), n_modes)


@pytest.mark.parametrize("representation", ["orthogonal", "nullspace"])
@pytest.mark.parametrize("prior", [[0.5, 0.5], [0.8, 0.2]])
def test_one_step_of_the_sampler_is_the_brute_force_posterior_mean(representation, prior):
    """Oracle: dense Gaussian conditioning with SciPy in head A's own space, no use of the eigenstructure."""
    reference = ExactReference(2, representation, mode_probabilities=prior)
    rng = np.random.default_rng(0)
    matrix = REPRESENTATION_MAPS[representation].matrix
    condition = CONDITIONS[:1]
    lift = np.kron(np.eye(16), matrix)
    covariance = lift @ np.kron(reference.generator.path_covariance(), np.eye(2)) @ lift.T
    means = reference.generator.mean_paths(condition[0]).reshape(2, -1) @ lift.T
    noise = rng.standard_normal((1, 3, 16, matrix.shape[0]))
    steps = 4
    expected = noise.reshape(3, -1).copy()
    for step in range(steps):
        t = step / steps
        marginal = (1 - t) ** 2 * np.eye(len(covariance)) + t**2 * covariance
        logs = np.stack([stats.multivariate_normal.logpdf(expected, t * m, marginal) for m in means])
        weights = np.exp(logs + np.log(prior)[:, None] - np.logaddexp.reduce(logs + np.log(prior)[:, None]))
        gain = (t * covariance - (1 - t) * np.eye(len(covariance))) @ np.linalg.inv(marginal)
        velocity = sum(w[:, None] * (m + (expected - t * m) @ gain.T) for w, m in zip(weights, means, strict=True))
        expected = expected + velocity / steps
    source = {"joint": torch.from_numpy(noise).float(), "position": torch.zeros(1, 3, 16, 2)}
    samples = reference.sample(batch(condition), 3, num_steps=steps, coupling=SamplingCoupling(source_noise=source))
    assert np.abs(samples.joint[0].numpy().reshape(3, -1) - expected).max() < 1e-4


def test_with_many_steps_the_samples_have_the_target_moments():
    reference = ExactReference(2, "nullspace", token="oracle")
    condition = CONDITIONS[:1]
    n = 20_000
    token = torch.ones(1, n, dtype=torch.int64)
    samples = reference.sample(
        batch(condition), n, num_steps=400, coupling=SamplingCoupling(token=token), generator=keyed_generator(2)
    )
    path = samples.position[0].numpy()
    mean = reference.generator.mean_paths(condition[0])[1]
    assert np.abs(path.mean(axis=0) - mean).max() < 5 * 0.09 / n**0.5
    covariance = np.cov(path[..., 0], rowvar=False)
    assert np.abs(covariance - reference.generator.path_covariance()).max() < 4e-4
    assert envelope()[0] == 0


def test_a_certain_mode_is_sampled_as_one_that_is_almost_certain():
    """Without a choice of modes Euler's steps have a closed form, which is used."""
    samples = [
        ExactReference(2, "nullspace", mode_probabilities=prior).sample(
            batch(CONDITIONS[:5]), 4, generator=keyed_generator(3)
        )
        for prior in ([1.0, 0.0], [1.0 - 1e-9, 1e-9])
    ]
    for head in ("joint", "position"):
        difference = getattr(samples[0], head) - getattr(samples[1], head)
        assert difference.abs().max() < 1e-4


def test_tokens_are_drawn_with_the_probabilities_given():
    reference = ExactReference(2, "nullspace", token="oracle", token_draw=[0.9, 0.1])
    token = reference.sample(batch(CONDITIONS), 100, generator=keyed_generator(4)).token
    assert token is not None
    assert abs(token.double().mean() - 0.1) < 5 * (0.09 / token.numel()) ** 0.5
    assert reference.describe()["token_draw"] == [0.9, 0.1]
    assert torch.allclose(reference.mode_given_token(), torch.eye(2))


def test_polar_moments_match_a_larger_independent_sample():
    radii, means, covariances = _moment_table("polar", 0.08)
    generator = RingGenerator(2)
    radius = radii[7]
    n = 100_000
    condition = np.broadcast_to([1.0, 0.0, radius], (n, 3))
    path = generator.draw_paths(np.random.default_rng(99), condition, np.zeros(n, dtype=np.int64))
    values = REPRESENTATION_MAPS["polar"].from_position(path).reshape(n, -1)
    deviation = values.std(axis=0)
    assert np.abs((values.mean(axis=0) - means[7]) / deviation).max() < 0.04
    assert np.abs((np.cov(values, rowvar=False) - covariances[7]) / np.outer(deviation, deviation)).max() < 0.04


def test_the_frozen_protocol_respects_the_theorem_in_every_condition_and_passes_tost_for_independent_noise():
    counts = table(ExactReference(2, "nullspace"))
    effects = coordination(both_valid(counts))
    assert counts.sum() == 75 * 1280
    assert (np.abs(effects.delta) <= effects.capacity).all()
    assert (effects.delta <= effects.capacity_tight).all()
    run = summarise_table(counts, label="independent", target=[0.5, 0.5])
    assert run.equivalence.equivalent
    assert run.valid_rate > 0.99


@pytest.mark.parametrize(
    ("representation", "n_modes", "options"),
    [
        ("nullspace", 2, {"source_noise_beta": 0.0}),
        ("orthogonal", 3, {"source_noise_beta": 0.0}),
        ("polar", 4, {"source_noise_beta": 0.0}),
        ("nullspace", 8, {"token": "oracle", "token_replacement_prob": 0.1}),
    ],
)
def test_no_condition_violates_the_bounds_for_any_coupling_map_or_number_of_modes(representation, n_modes, options):
    counts = table(ExactReference(n_modes, representation, **options), n_modes, pairs=200)
    effects = coordination(both_valid(counts))
    assert (np.abs(effects.delta) <= effects.capacity + 1e-15).all()
    assert (effects.delta <= effects.capacity_tight + 1e-15).all()


def test_shared_noise_under_the_nullspace_map_coordinates_as_its_correlation_predicts():
    """The heads' mode-deciding projections correlate at -0.35; the sign agreement of a Gaussian pair is asin."""
    run = summarise_table(table(ExactReference(2, "nullspace", source_noise_beta=0.0)), label="shared")
    assert run.rho == pytest.approx(2 / np.pi * np.arcsin(-0.35), abs=0.02)


def test_an_oracle_token_reaches_the_corner_and_replacement_takes_it_back():
    assert summarise_table(table(ExactReference(2, "nullspace", token="oracle")), label="oracle").rho == 1
    replaced = table(ExactReference(2, "nullspace", token="oracle", token_replacement_prob=0.1))
    # Each head follows the token with probability 0.95 at the exact target, a little more often in 20 steps.
    assert summarise_table(replaced, label="replaced").rho == pytest.approx(0.9**2, abs=0.04)


def test_redrawn_tokens_return_to_the_floor():
    run = summarise_table(table(ExactReference(2, "nullspace", token="oracle"), share_token=False), label="redrawn")
    assert abs(run.rho) < 0.02


def test_the_caller_draws_the_tokens_otherwise():
    skewed = ExactReference(2, "nullspace", token="oracle", mode_probabilities=[0.9, 0.1])
    shares = []
    for draw in (None, "marginal"):
        counts = table(skewed, token_draw=draw).sum(axis=0)
        shares.append(counts[0, :2].sum() / counts[:2, :2].sum())
    assert shares == pytest.approx([0.5, 0.9], abs=0.02)
    with pytest.raises(ValueError, match="learns no prior"):
        table(skewed, token_draw="learned")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"representation": "cubic"}, "representation='cubic' is not one of"),
        ({"representation": "polar", "token": "window"}, "has no exact reference"),
        ({"representation": "polar", "token_replacement_prob": 2}, "must lie in"),
        ({"representation": "polar", "mode_probabilities": [0.5, 0.6]}, "sum to 1"),
        ({"representation": "polar", "token": "oracle", "token_draw": [0.5, 0.6]}, "sum to 1, one per token"),
    ],
)
def test_what_has_no_reference_is_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        ExactReference(2, **arguments)
