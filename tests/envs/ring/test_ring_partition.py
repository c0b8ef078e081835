"""The ring's mode partition and the expert whose paths it labels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dualhead_envs.ring.generator import RingGenerator, envelope
from dualhead_envs.ring.geometry import condition_vector, mode_angles, mode_directions
from dualhead_envs.ring.partition import RingPartition

modes = st.sampled_from([2, 3, 4, 8])
angles = st.floats(-6.0, 6.0)
radii = st.floats(0.7, 1.3)
paths = hnp.arrays(np.float64, (16, 2), elements=st.floats(-2, 2))


def rotated(path, angle):
    return path @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


@given(modes, angles, radii, st.data())
def test_the_mean_path_of_a_mode_has_its_label_and_full_strength(n_modes, theta, radius, data):
    mode = data.draw(st.integers(0, n_modes - 1))
    condition = condition_vector(theta, radius)
    path = RingGenerator(n_modes).mean_paths(condition)[mode]
    label, strength = RingPartition(n_modes).score(path, condition)
    assert label == mode
    assert strength == pytest.approx(envelope().max())


@given(modes, angles, radii, paths, angles)
def test_rotating_the_world_changes_nothing(n_modes, theta, radius, path, turn):
    partition = RingPartition(n_modes)
    _, strength = partition.score(path, condition_vector(theta, radius))
    _, turned = partition.score(rotated(path, turn), condition_vector(theta + turn, radius))
    assert turned == pytest.approx(strength, abs=1e-12)


@given(modes, angles, radii, paths, st.floats(0.5, 2.0))
def test_only_size_relative_to_the_radius_counts(n_modes, theta, radius, path, scale):
    partition = RingPartition(n_modes)
    _, strength = partition.score(path, condition_vector(theta, radius))
    _, scaled = partition.score(scale * path, condition_vector(theta, scale * radius))
    assert scaled == pytest.approx(strength, abs=1e-12)


@given(modes, paths, st.floats(0.01, 2.0))
def test_a_label_is_kept_from_the_threshold_upwards(n_modes, path, tau):
    condition = condition_vector(0.3, 1.0)
    partition = RingPartition(n_modes)
    label, strength = partition.score(path, condition)
    assert partition.assign(path, condition, tau=tau) == (label if strength >= tau else -1)
    assert partition.assign(path, condition) == partition.assign(path, condition, tau=0.55)


@given(st.data())
def test_leading_axes_broadcast(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 100)))
    partition = RingPartition(4)
    path, condition = rng.normal(size=(3, 5, 16, 2)), condition_vector(rng.uniform(0, 6, (3, 1)), 1.0)
    together = partition.assign(path, condition)
    assert together.shape == (3, 5)
    assert together.dtype == np.int64
    one_by_one = [[partition.assign(path[i, j], condition[i, 0]) for j in range(5)] for i in range(3)]
    np.testing.assert_array_equal(together, one_by_one)


def test_the_threshold_itself_is_valid():
    condition = condition_vector(0.0, 1.0)
    assert RingPartition(2, tau=0.5).assign([[0.5, 0.0]], condition) == 0
    assert RingPartition(2, tau=0.5).assign([[0.5 - 1e-9, 0.0]], condition) == -1


@pytest.mark.parametrize(
    ("path", "condition", "message"),
    [
        (np.full((16, 2), np.nan), [1, 0, 1], "NaN"),
        (np.zeros((16, 3)), [1, 0, 1], r"expected \(\.\.\., H, 2\)"),
        (np.zeros((0, 2)), [1, 0, 1], r"expected \(\.\.\., H, 2\)"),
        (np.zeros((16, 2)), [1, 0, np.nan], "condition"),
        (np.zeros((16, 2)), [1, 0, -1], "condition"),
        (np.zeros((16, 2)), [1, 0], "condition"),
        (np.zeros((16, 2)), [1.3, 0, 0.5], "condition"),
    ],
)
def test_what_cannot_be_labelled_is_refused(path, condition, message):
    with pytest.raises(ValueError, match=message):
        RingPartition(2).assign(path, condition)


@pytest.mark.parametrize("tau", [0.0, -1.0, np.nan, np.inf])
def test_a_threshold_is_positive(tau):
    with pytest.raises(ValueError, match="tau="):
        RingPartition(2).assign(np.zeros((16, 2)), [1, 0, 1], tau=tau)


@given(modes, angles, radii)
def test_modes_are_unit_vectors_at_equal_angles(n_modes, theta, radius):
    directions = mode_directions(condition_vector(theta, radius), mode_angles(n_modes))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(directions.sum(axis=0), 0.0, atol=1e-12)


def test_paths_have_the_stated_mean_and_covariance():
    generator = RingGenerator(3, path_spread=0.2)
    condition = condition_vector(0.7, 0.9)
    sample = generator.draw_paths(np.random.default_rng(0), condition, np.full(40_000, 2))
    deviation = sample - generator.mean_paths(condition)[2]
    np.testing.assert_allclose(deviation.mean(axis=0), 0.0, atol=0.005)
    for axis in range(2):
        np.testing.assert_allclose(np.cov(deviation[..., axis].T), generator.path_covariance(), atol=0.001)
    across = np.einsum("ni,nj->ij", deviation[..., 0], deviation[..., 1]) / len(sample)
    np.testing.assert_allclose(across, 0.0, atol=0.001)


def test_modes_follow_the_prior():
    prior = (0.70, 0.15, 0.10, 0.05)
    drawn = RingGenerator(4, prior).draw_modes(np.random.default_rng(0), 40_000)
    np.testing.assert_allclose(np.bincount(drawn) / len(drawn), prior, atol=0.01)


def test_conditions_cover_the_circle_and_the_radii():
    condition = RingGenerator(2).draw_conditions(np.random.default_rng(0), 10_000)
    np.testing.assert_allclose(condition[:, :2].mean(axis=0), 0.0, atol=0.03)
    assert 0.70 <= condition[:, 2].min() < 0.71
    assert 1.29 < condition[:, 2].max() <= 1.30


def test_reduced_separability_makes_paths_invalid_or_ambiguous():
    condition = condition_vector(0.0, 1.0)
    rng = np.random.default_rng(0)
    partition = RingPartition(8)
    for spread, misses in ((0.08, 0.0), (0.4, 0.2)):
        path = RingGenerator(8, path_spread=spread).draw_paths(rng, condition, np.zeros(2000, dtype=int))
        assert (partition.assign(path, condition) != 0).mean() == pytest.approx(misses, abs=0.02) or misses
