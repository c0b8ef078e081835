"""The representation maps: round trips and the properties that the paper relies on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dualhead_envs.ring.maps import REPRESENTATION_MAPS, representation_map

positions = hnp.arrays(np.float64, st.tuples(st.integers(1, 5), st.just(2)), elements=st.floats(-1.5, 1.5))


@pytest.mark.parametrize("name", sorted(REPRESENTATION_MAPS))
@given(position=positions)
def test_a_position_returns_to_itself(name, position):
    chosen = REPRESENTATION_MAPS[name]
    there = chosen.from_position(position)
    assert there.shape == (len(position), chosen.width)
    np.testing.assert_allclose(chosen.to_position(there), position, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["orthogonal", "nullspace"])
@given(position=positions)
def test_linear_maps_keep_lengths(name, position):
    lengths = np.linalg.norm(REPRESENTATION_MAPS[name].from_position(position), axis=-1)
    np.testing.assert_allclose(lengths, np.linalg.norm(position, axis=-1), atol=1e-14)


def test_the_reflection_mirrors_the_second_axis():
    np.testing.assert_array_equal(REPRESENTATION_MAPS["orthogonal"].from_position([0.3, 0.4]), [0.3, -0.4])


def test_the_lift_has_orthonormal_columns_and_an_empty_null_space_part():
    matrix = REPRESENTATION_MAPS["nullspace"].matrix
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(matrix[:2], -0.35 * np.eye(2))
    np.testing.assert_array_equal(matrix[4:], 0.0)


@given(radius=st.floats(0.01, 1.5), angle=st.floats(-3, 3))
def test_polar_stretches_the_radius_and_twists_by_it(radius, angle):
    point = radius * np.array([np.cos(angle), np.sin(angle)])
    x, y = REPRESENTATION_MAPS["polar"].from_position(point)
    assert np.hypot(x, y) == pytest.approx(radius**0.7)
    turned = np.arctan2(y, x) - (angle + 0.6 * radius)
    assert np.cos(turned) == pytest.approx(1.0)


def test_unknown_maps_and_wrong_widths_are_refused():
    with pytest.raises(ValueError, match="representation='cartesian'"):
        representation_map("cartesian")
    with pytest.raises(ValueError, match=r"expected \(\.\.\., 6\)"):
        representation_map("nullspace").to_position(np.zeros((4, 2)))


@pytest.mark.parametrize("name", ["overlap+40", "overlap-90", "overlap+0", "rotation+45", "rotation-180", "polar_50_0"])
def test_every_member_of_a_family_undoes_itself(name):
    family = representation_map(name)
    assert family.name == name
    points = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_allclose(family.to_position(family.from_position(points)), points, atol=1e-13)


def test_families_hold_the_testbeds_maps():
    points = np.random.default_rng(0).normal(size=(50, 2))
    for member, named in (("overlap-35", "nullspace"), ("polar_70_60", "polar")):
        np.testing.assert_array_equal(
            representation_map(member).from_position(points), representation_map(named).from_position(points)
        )


@pytest.mark.parametrize(
    "name",
    ["overlap", "overlap-0", "overlap+100", "overlap+040", "rotation+181", "rotation45", "polar_0_60", "polar_7"],
)
def test_what_is_in_no_family_is_refused(name):
    with pytest.raises(ValueError, match="nor of the families"):
        representation_map(name)
