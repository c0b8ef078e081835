"""Residuals in their units, their strata, and ensemble scores split by mode."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import mannwhitneyu
from sklearn.metrics import roc_auc_score

from dualhead_eval.ensembles.scores import action_l2, contamination, time_weight, vfd_score
from dualhead_eval.residuals.distances import (
    mode_direction,
    nearest_yaw_labels,
    position_residual_mm,
    rotation_matrices,
    rotation_residual_deg,
    split_residual_mm,
)
from dualhead_eval.residuals.strata import ResidualStrata, residual_strata, summarise_strata


def six(rotations):
    return np.concatenate([rotations.as_matrix()[..., 0], rotations.as_matrix()[..., 1]], axis=-1)


def test_a_constant_offset_is_its_length_in_millimetres():
    path = np.random.default_rng(0).normal(size=(5, 16, 3))
    np.testing.assert_allclose(position_residual_mm(path, path + np.array([0.003, 0.004, 0])), 5.0)
    with pytest.raises(ValueError, match="shapes"):
        position_residual_mm(path, path[..., :2])


@given(st.integers(0, 10**6))
def test_lateral_and_orthogonal_parts_are_pythagorean_for_single_steps(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 7, 1, 3))
    lateral, orthogonal = split_residual_mm(a, b, rng.normal(size=(7, 3)))
    np.testing.assert_allclose(np.hypot(lateral, orthogonal), position_residual_mm(a, b))
    with pytest.raises(ValueError, match="zero"):
        split_residual_mm(a, b, np.zeros(3))


@given(st.integers(0, 10**6))
def test_the_mode_direction_is_the_line_between_two_modes(seed):
    rng = np.random.default_rng(seed)
    apart = rng.normal(size=3)
    common = rng.normal(size=(16, 3))
    rise = np.sin(np.pi * np.arange(16) / 15)[:, None]
    direction = mode_direction(np.stack([common + rise * apart, common - rise * apart]))
    assert abs(direction @ apart) == pytest.approx(np.linalg.norm(apart))
    with pytest.raises(ValueError, match="two modes"):
        mode_direction(common[None])


@settings(max_examples=50)
@given(st.integers(0, 10**6), st.sampled_from([1e-7, 1e-3, 1.0, 3.1]))
def test_the_geodesic_angle_is_scipys(seed, angle):
    rng = np.random.default_rng(seed)
    a = Rotation.random(4, rng=rng)
    axis = rng.normal(size=(4, 3))
    b = a * Rotation.from_rotvec(angle * axis / np.linalg.norm(axis, axis=1, keepdims=True))
    np.testing.assert_allclose(rotation_residual_deg(six(a), six(b)), np.degrees(angle), rtol=1e-6)
    np.testing.assert_allclose(rotation_matrices(3 * six(a)), a.as_matrix(), atol=1e-12)


def test_orientations_take_the_mode_of_the_nearest_yaw():
    yaw = np.array([0.44, -0.1, 3.1])
    windows = np.stack([six(Rotation.from_rotvec([[0, 0, y]] * 16)) for y in yaw])
    np.testing.assert_array_equal(nearest_yaw_labels(windows, [0.45, -0.45, -3.1]), [0, 1, 2])
    with pytest.raises(ValueError, match="first two columns"):
        nearest_yaw_labels(np.zeros((2, 16, 4)), [0, 1])


def example(seed=0, conditions=6, n=80):
    rng = np.random.default_rng(seed)
    a, b = rng.integers(-1, 2, size=(2, conditions, n))
    residual = np.round(rng.gamma(2, 10, size=(conditions, n)) + 20 * (a != b), 1)
    return residual, a, b


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_strata_reproduce_means_medians_u_and_auroc(seed):
    residual, a, b = example(seed)
    strata = residual_strata(residual, a, b)
    for c in range(len(residual)):
        valid = (a[c] >= 0) & (b[c] >= 0)
        same, cross = residual[c][valid & (a[c] == b[c])], residual[c][valid & (a[c] != b[c])]
        np.testing.assert_array_equal(strata.n[c], [same.size, cross.size])
        np.testing.assert_allclose(strata.total[c], [same.sum(), cross.sum()])
        np.testing.assert_allclose(strata.squares[c], [(same**2).sum(), (cross**2).sum()])
        np.testing.assert_allclose(strata.median[c], [np.median(same), np.median(cross)])
        assert strata.u[c] == mannwhitneyu(cross, same).statistic
        auroc = roc_auc_score(np.repeat([1, 0], [cross.size, same.size]), np.concatenate([cross, same]))
        assert summarise_strata(strata.at((slice(c, c + 1),))).auroc == pytest.approx(auroc, abs=1e-12)
    run = summarise_strata(strata)
    everything = (a >= 0) & (b >= 0)
    assert run.mean == pytest.approx(residual[everything].mean())
    assert run.cross_share == pytest.approx(residual[everything & (a != b)].sum() / residual[everything].sum())
    assert run.over_floor == pytest.approx(run.mean / run.same)


def test_strata_that_never_occur_are_nan_not_zero():
    strata = residual_strata([[1.0, 2.0]], [[0, 0]], [[0, 0]])
    run = summarise_strata(strata)
    assert run.same == run.mean == 1.5
    assert np.isnan([run.cross, run.auroc, strata.median[0, 1]]).all()
    assert run.cross_share == 0
    assert run.auroc_conditions == 0


def test_residuals_of_invalid_samples_do_not_matter_and_those_of_valid_ones_must_be_distances():
    assert residual_strata([[np.nan, 2.0]], [[-1, 0]], [[0, 0]]).n.sum() == 1
    with pytest.raises(ValueError, match="NaN or negative"):
        residual_strata([[np.nan, 2.0]], [[0, 0]], [[0, 0]])
    with pytest.raises(ValueError, match="one shape"):
        residual_strata([1.0, 2.0], [0], [0])
    with pytest.raises(ValueError, match="outside"):
        ResidualStrata(*np.ones((4, 3, 2), dtype=int), np.full(3, 5.0))


def test_action_l2_is_the_distance_between_members():
    samples = np.zeros((3, 4, 16, 2))
    samples[1] += [3.0, 4.0]
    distances = action_l2(samples)
    assert distances.shape == (3, 3, 4)
    np.testing.assert_allclose(distances[0, 1], 5.0)
    np.testing.assert_allclose(distances[0, 2], 0.0)
    with pytest.raises(ValueError, match="two members"):
        action_l2(samples[:1])


def test_vfds_weight_averages_2598_over_twenty_steps():
    assert np.mean([time_weight(step / 20) for step in range(20)]) == pytest.approx(2.598, abs=5e-4)


def test_vfd_of_constant_fields_is_their_squared_gap_times_the_weight():
    fields = [lambda x, s, c=c: np.full_like(x, c) for c in (0.0, 1.0)]
    plain = vfd_score(fields, np.zeros((3, 2)), weighted=False)
    np.testing.assert_allclose(plain[0, 1], 2.0)
    np.testing.assert_allclose(plain[0, 0], 0.0)
    weighted = vfd_score(fields, np.zeros((3, 2)))
    np.testing.assert_allclose(weighted[1, 0], 2.0 * 2.5977, rtol=1e-4)


def test_vfd_follows_each_members_own_path():
    """Fields that agree where member 0 walks and differ where member 1 walks: only one order sees it."""
    fields = [lambda x, s: np.ones_like(x), lambda x, s: np.where(x < 0.5, 1.0, 3.0)]
    scores = vfd_score(fields, np.zeros((1, 1)), num_steps=10, weighted=False)
    assert scores[0, 1] == scores[1, 0] > 0
    turned = [lambda x, s: -np.ones_like(x), lambda x, s: np.where(x > -0.05, -1.0, 1.0)]
    scores = vfd_score(turned, np.zeros((1, 1)), num_steps=10, weighted=False)
    assert scores[0, 1] != scores[1, 0]
    with pytest.raises(ValueError, match="two members"):
        vfd_score(fields[:1], np.zeros((1, 1)))


def test_shared_noise_lowers_the_contamination_of_an_ensemble():
    rng = np.random.default_rng(0)
    mode_private, noise = rng.integers(0, 2, size=(3, 200)), rng.normal(scale=0.01, size=(3, 200, 16, 2))
    mode_shared = np.broadcast_to(mode_private[:1], (3, 200))
    shares = []
    for modes in (mode_private, mode_shared):
        samples = noise + modes[..., None, None] * [0.0, 1.0]
        strata = contamination(action_l2(samples), modes)
        assert len(strata) == 6
        shares.append(summarise_strata(strata[0, 1]).cross_share)
    assert shares[0] > 0.9
    assert shares[1] == 0
    with pytest.raises(ValueError, match="labels"):
        contamination(np.zeros((3, 3, 5)), np.zeros((3, 4)))
