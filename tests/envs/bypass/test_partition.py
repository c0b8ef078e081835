"""The mode partitions: what they say of a path, and what they do not depend on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from dualhead_envs.bypass.partition import BimodalPartition, RotatingPartition, ThreeWayPartition

METRES = st.floats(-0.5, 0.5, allow_nan=False, width=64)
PATHS = npst.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 16), st.just(3)), elements=METRES)
ANGLES = st.floats(0.0, np.pi / 2 - 1e-6)
V2_CONDITION = np.zeros(18)
PARTITIONS = [BimodalPartition(), ThreeWayPartition(), RotatingPartition()]
#: Azimuths of left, right and over in the whitened cross-section.
WAYS = (0.0, np.pi, np.pi / 2)


def condition(phi, radius=0.2):
    """v3's environment_state: routes in the last three numbers."""
    return np.concatenate([np.zeros(18), [radius, np.cos(phi), np.sin(phi)]])


def route(psi, radius, steps=16):
    """A path out to the apex at azimuth psi and radius, at 0.955 m, flattened by 0.68."""
    out = np.linspace(0.0, 1.0, steps)[:, None]
    return np.array([0.0, 0.0, 0.955]) + out * radius * np.array([0.0, np.cos(psi), 0.68 * np.sin(psi)])


@given(PATHS)
def test_mirroring_swaps_v2s_labels(path):
    partition = BimodalPartition()
    label, strength = partition.score(path, V2_CONDITION)
    mirrored, same = partition.score(path * [1, -1, 1], V2_CONDITION)
    np.testing.assert_array_equal(strength, same)
    y = path[..., 1]
    decided = y.max(axis=-1) != -y.min(axis=-1)
    np.testing.assert_array_equal(mirrored[decided], 1 - label[decided])


@given(PATHS)
def test_v2_is_the_sign_of_y_where_it_is_largest(path):
    label, strength = BimodalPartition().score(path, V2_CONDITION)
    for one, k, peak in zip(path, label, strength, strict=True):
        assert peak == np.abs(one[:, 1]).max()
        if np.count_nonzero(np.abs(one[:, 1]) == peak) == 1:
            assert (k == 0) == (one[np.abs(one[:, 1]).argmax(), 1] >= 0 or peak == 0)


@given(PATHS)
def test_mirroring_three_ways_swaps_left_and_right_and_leaves_over(path):
    partition = ThreeWayPartition()
    label, strength = partition.score(path, V2_CONDITION)
    mirrored, same = partition.score(path * [1, -1, 1], V2_CONDITION)
    np.testing.assert_array_equal(strength, same)
    y, rise = path[..., 1], (path[..., 2] - 0.955) / 0.68
    peaks = np.sort(np.stack([y.max(axis=-1), -y.min(axis=-1), rise.max(axis=-1)]), axis=0)
    decided = peaks[-1] != peaks[-2]
    np.testing.assert_array_equal(mirrored[decided], np.array([1, 0, 2])[label[decided]])


@given(st.floats(-np.pi / 2, 3 * np.pi / 2), st.floats(0.01, 0.3))
def test_three_ways_are_told_by_the_nearest_azimuth(psi, radius):
    label, strength = ThreeWayPartition().score(route(psi, radius), V2_CONDITION)
    towards = np.cos(psi - np.array(WAYS))
    assert strength == pytest.approx(max(radius * towards.max(), 0.0), abs=1e-12)
    if np.sort(towards)[-1] - np.sort(towards)[-2] > 1e-9 and strength > 1e-9:
        assert label == towards.argmax()


@given(npst.arrays(np.float64, 3, elements=st.floats(0.001, 1.0)))
def test_a_blend_of_the_three_ways_is_invalid_unless_one_is_two_thirds_of_it(weight):
    weight = weight / weight.sum()
    blend = sum(share * route(psi, 0.165) for share, psi in zip(weight, WAYS, strict=True))
    if weight.max() < 2 / 3 - 1e-9:
        assert ThreeWayPartition().assign(blend, V2_CONDITION) == -1


@given(PATHS)
def test_a_path_that_stays_low_has_the_same_label_with_two_ways_and_three(path):
    path[..., 2] = np.minimum(path[..., 2], 0.955)
    for two, three in zip(
        BimodalPartition().score(path, V2_CONDITION), ThreeWayPartition().score(path, V2_CONDITION), strict=True
    ):
        np.testing.assert_array_equal(two, three)


@given(ANGLES, st.floats(0.17, 0.215), st.integers(0, 1))
def test_v3s_labels_follow_the_azimuths(phi, radius, mode):
    path = route(phi + mode * np.pi / 2, radius)
    label, strength = RotatingPartition().score(path, condition(phi, radius))
    assert label == mode
    assert strength == pytest.approx(radius, abs=1e-12)


@given(ANGLES, st.floats(0.0, 2 * np.pi), st.floats(0.01, 0.3))
def test_mirroring_v3s_routes_swaps_its_labels(phi, psi, radius):
    # y -> -y takes the azimuths {phi, phi + pi/2} to {pi - phi, pi/2 - phi}: the image of mode 1 is mode 0.
    partition = RotatingPartition()
    label, strength = partition.score(route(psi, radius), condition(phi))
    mirrored, same = partition.score(route(np.pi - psi, radius), condition(np.pi / 2 - phi))
    assert strength == pytest.approx(same, abs=1e-12)
    if abs(np.cos(psi - phi) - np.sin(psi - phi)) > 1e-9 and strength > 1e-9:
        assert mirrored == 1 - label


@pytest.mark.parametrize("partition", PARTITIONS)
@given(npst.arrays(np.float64, (16, 3), elements=METRES), ANGLES)
def test_a_path_can_be_followed_one_point_at_a_time(partition, path, phi):
    state = condition(phi)
    best = (0, -np.inf)
    for point in path:
        label, strength = partition.score_point(point, state)
        if strength > best[1]:
            best = (label, strength)
    label, strength = partition.score(path, state)
    assert best[1] == pytest.approx(strength, abs=1e-12)
    if abs(partition.score(path[:, [0, 1, 2]] * [1, -1, 1], state)[1] - strength) > 1e-9:
        assert best[0] == label


@pytest.mark.parametrize("partition", PARTITIONS)
@given(st.floats(0.02, 0.3), st.floats(0.5, 1.5))
def test_a_path_is_valid_exactly_when_its_peak_reaches_tau(partition, tau, share):
    path, state = route(0.0, tau * share), condition(0.0)
    expected = 0 if partition.score(path, state)[1] >= tau else -1
    assert partition.assign(path, state, tau=tau) == expected
    if abs(share - 1.0) > 1e-9:
        assert expected == (0 if share > 1.0 else -1)
    # Scaling offsets and threshold together changes nothing.
    assert partition.assign(route(0.0, 1.1 * share * tau), state, tau=1.1 * tau) == expected or share == 1.0


@pytest.mark.parametrize("partition", PARTITIONS)
def test_leading_axes_broadcast(partition):
    rng = np.random.default_rng(0)
    paths = np.array([0.0, 0.0, 0.955]) + rng.normal(0.0, 0.15, (5, 7, 16, 3))
    states = np.stack([condition(phi) for phi in np.linspace(0.0, 1.5, 5)])[:, None]
    labels = partition.assign(paths, states)
    assert labels.shape == (5, 7)
    assert labels.dtype == np.int64
    assert set(np.unique(labels)) <= {-1, *range(partition.n_modes)}
    for i in range(5):
        np.testing.assert_array_equal(labels[i], partition.assign(paths[i], states[i, 0]))
    assert partition.assign(paths[0, 0], states[:, 0]).shape == (5,)


@pytest.mark.parametrize("partition", PARTITIONS)
@pytest.mark.parametrize(
    ("path", "state", "words"),
    [
        (np.full((16, 3), np.nan), condition(0.3), "NaN"),
        (np.zeros((16, 2)), condition(0.3), "expected"),
        (np.zeros(3), condition(0.3), "expected"),
        (np.zeros((16, 3)), np.full(21, np.inf), "finite"),
    ],
)
def test_bad_paths_and_conditions_are_one_sentence(partition, path, state, words):
    with pytest.raises(ValueError, match=words) as error:
        partition.assign(path, state)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("tau", [0.0, -1.0, np.nan])
def test_a_threshold_is_a_positive_length(tau):
    with pytest.raises(ValueError, match="positive length"):
        BimodalPartition(tau)
    with pytest.raises(ValueError, match="positive length"):
        RotatingPartition().assign(route(0.0, 0.2), condition(0.0), tau=tau)


def test_v3_refuses_v2s_condition():
    with pytest.raises(ValueError, match="RotatingBypass-v3"):
        RotatingPartition().assign(route(0.0, 0.2), np.full(18, 0.3))


@given(ANGLES, st.integers(0, 1))
def test_the_orientation_rule_tells_the_two_yaws_apart(phi, mode):
    yaw = 0.45 * np.cos(phi + mode * np.pi / 2) * np.linspace(0.0, 1.0, 16)
    rotation = np.stack([-np.cos(yaw), -np.sin(yaw), 0 * yaw, -np.sin(yaw), np.cos(yaw), 0 * yaw], axis=-1)
    assert RotatingPartition().assign_rotation(rotation, condition(phi)) == mode
