"""Labels become joint tables without losing a sample."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualhead_eval.effects.counts import all_valid_agreement, both_valid, joint_counts, joint_table, pair_counts


@st.composite
def label_sets(draw, heads=2):
    k = draw(st.integers(2, 5))
    shape = draw(st.sampled_from([(12,), (3, 8), (2, 3, 5)]))
    seed = draw(st.integers(0, 2**32 - 1))
    return k, np.random.default_rng(seed).integers(-1, k, size=(heads, *shape))


@given(label_sets(heads=3))
def test_joint_table_counts_every_sample_once(drawn):
    k, labels = drawn
    table = joint_counts(*labels[:2], k, labels[2])
    expected = np.zeros_like(table)
    for where in np.ndindex(labels.shape[1:]):
        cell = tuple(k if label[where] < 0 else label[where] for label in labels)
        expected[(*where[:-1], *cell)] += 1
    np.testing.assert_array_equal(table, expected)


@given(label_sets(heads=3))
def test_tables_of_two_heads_follow_from_the_table_of_all(drawn):
    k, labels = drawn
    table = joint_table(list(labels), k)
    for first, second in [(0, 1), (1, 2), (2, 0)]:
        np.testing.assert_array_equal(
            pair_counts(table, 3, first, second), joint_counts(labels[first], labels[second], k)
        )


@given(label_sets(heads=3))
def test_three_way_agreement_is_over_samples_valid_in_all_heads(drawn):
    k, labels = drawn
    valid, agreeing = all_valid_agreement(joint_table(list(labels), k), 3)
    everywhere = (labels >= 0).all(axis=0)
    np.testing.assert_array_equal(valid, everywhere.sum(axis=-1))
    same = everywhere & (labels[0] == labels[1]) & (labels[1] == labels[2])
    np.testing.assert_array_equal(agreeing, same.sum(axis=-1))


def test_the_last_row_and_column_hold_the_invalid_samples():
    table = joint_counts([0, 1, -1, -1], [0, -1, 1, -1], n_modes=2)
    np.testing.assert_array_equal(table, [[1, 0, 0], [0, 0, 1], [0, 1, 1]])
    assert both_valid(table).sum() == 1


@pytest.mark.parametrize(
    ("a", "b", "k", "message"),
    [
        ([0, 2], [0, 1], 2, "label 2 is outside"),
        ([0, -2], [0, 1], 2, "label -2 is outside"),
        ([0, 1], [0, 1, 1], 2, "shapes"),
        ([0, 1], [0, 1], 1, "n_modes=1"),
        ([0, np.nan], [0, 1], 2, "NaN"),
        (["L", "R"], [0, 1], 2, "dtype"),
        (0, 1, 2, "shapes"),
    ],
)
def test_labels_that_are_not_modes_are_refused(a, b, k, message):
    with pytest.raises(ValueError, match=message):
        joint_counts(a, b, k)


def test_one_head_is_not_a_pair():
    with pytest.raises(ValueError, match="two or more"):
        joint_table([[0, 1]], 2)
