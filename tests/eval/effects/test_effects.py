"""The coordination effect is the classical agreement statistics, exact where they are exact."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.metrics import cohen_kappa_score, matthews_corrcoef

from dualhead_eval.effects.contingency import UNDEFINED_REASONS, coordination
from dualhead_eval.effects.dependence import diversity_from_effect

MODES = st.integers(2, 8)


def tables(largest: int = 1_000_000):
    return MODES.flatmap(lambda k: arrays(np.int64, (k, k), elements=st.integers(0, largest)))


def as_labels(table):
    """The table as two label vectors with weights, the form scikit-learn takes."""
    k = len(table)
    a, b = np.divmod(np.arange(k * k), k)
    return a, b, table.ravel().astype(float)


@settings(max_examples=500, deadline=None)
@given(tables())
def test_rho_and_kappa_are_scikit_learns(table):
    effect = coordination(table)
    a, b, weight = as_labels(table)
    if effect.capacity > 0:
        assert effect.rho == pytest.approx(matthews_corrcoef(a, b, sample_weight=weight), abs=1e-12)
    else:
        assert np.isnan(effect.rho)
        assert effect.reason
    if effect.bl > 0:
        assert effect.kappa == pytest.approx(cohen_kappa_score(a, b, sample_weight=weight), abs=1e-12)
    else:
        assert np.isnan(effect.kappa)


@pytest.mark.slow
def test_rho_and_kappa_are_scikit_learns_on_ten_thousand_tables():
    rng = np.random.default_rng(0)
    for k in (2, 3, 4, 8):
        size = 10.0 ** rng.uniform(0, 6, size=(2500, 1, 1))
        bank = np.floor(rng.random((2500, k, k)) ** 3 * size).astype(np.int64)
        effect = coordination(bank)
        for i, table in enumerate(bank):
            if effect.undefined[i]:
                continue
            a, b, weight = as_labels(table)
            assert abs(effect.rho[i] - matthews_corrcoef(a, b, sample_weight=weight)) < 1e-12
            assert abs(effect.kappa[i] - cohen_kappa_score(a, b, sample_weight=weight)) < 1e-12


@settings(max_examples=300, deadline=None)
@given(tables())
def test_the_theorems_bounds_hold_without_a_tolerance(table):
    effect = coordination(table)
    if effect.n == 0:
        return
    k = len(table)
    assert abs(effect.delta) <= effect.capacity
    assert effect.delta <= effect.capacity_tight <= effect.capacity
    assert effect.capacity <= (1 - 1 / k) * (1 + 1e-15)
    assert effect.capacity_tight == pytest.approx(effect.bl - effect.tv, abs=1e-12)
    certified = diversity_from_effect(effect.delta, k)
    assert effect.diversity_q >= certified - 1e-12
    assert effect.diversity_p >= certified - 1e-12


@settings(max_examples=200, deadline=None)
@given(tables(), st.randoms(use_true_random=False))
def test_relabelling_the_modes_changes_nothing_and_swapping_the_heads_mirrors(table, random):
    order = list(range(len(table)))
    random.shuffle(order)
    before, after = coordination(table), coordination(table[np.ix_(order, order)])
    swapped = coordination(table.T)
    for name in ("n", "obs", "bl", "delta", "capacity", "capacity_tight", "rho", "kappa"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
        np.testing.assert_array_equal(getattr(before, name), getattr(swapped, name))
    np.testing.assert_array_equal(before.q, swapped.p)


@given(st.lists(st.integers(0, 10**6), min_size=2, max_size=8).filter(lambda x: sum(v > 0 for v in x) > 1))
def test_perfect_agreement_with_equal_marginals_is_exactly_at_the_boundary(diagonal):
    effect = coordination(np.diag(diagonal))
    assert effect.delta == effect.capacity == effect.capacity_tight
    assert effect.rho == 1.0
    assert effect.obs == 0.0


@given(arrays(np.int64, 4, elements=st.integers(1, 1000)), arrays(np.int64, 4, elements=st.integers(1, 1000)))
def test_independent_heads_have_no_effect_exactly(q, p):
    effect = coordination(np.outer(q, p))
    assert effect.delta == 0.0
    assert effect.rho == 0.0


def test_the_tight_bound_meets_the_outer_one_only_at_equal_marginals():
    unequal = coordination([[50, 0], [20, 30]])
    assert unequal.delta == unequal.capacity_tight < unequal.capacity


def test_a_head_with_a_single_mode_leaves_rho_undefined_and_says_which():
    effect = coordination([[[3, 4], [0, 0]], [[5, 0], [7, 0]], [[9, 0], [0, 0]], [[0, 0], [0, 0]]])
    assert np.isnan(effect.rho).all()
    np.testing.assert_array_equal(effect.undefined, [1, 2, 3, 4])
    assert [reason.split(":")[0] for reason in effect.reason] == [
        "head A chose a single mode",
        "head B chose a single mode",
        "both heads chose a single mode each",
        "no pair in which both heads are valid",
    ]
    np.testing.assert_array_equal(effect.delta[:3], 0)
    np.testing.assert_array_equal(effect.capacity[:3], 0)
    assert np.isnan(effect.delta[3])
    assert UNDEFINED_REASONS[0] == ""


def test_dependence_off_the_diagonal_is_invisible_at_three_modes():
    """sec:calculus: one label fixed and two swapped; delta is 0 at capacity 2/3 with perfect dependence."""
    effect = coordination([[100, 0, 0], [0, 0, 100], [0, 100, 0]])
    assert effect.delta == 0
    assert effect.rho == 0
    assert effect.capacity == effect.capacity_tight == pytest.approx(2 / 3, abs=1e-15)


def test_counts_beyond_int64_stay_exact():
    huge = 10**30
    effect = coordination(np.array([[huge, 1], [0, huge]], dtype=object))
    assert effect.rho == pytest.approx(1.0, abs=1e-15)
    assert coordination([[3_000_000_000, 0], [0, 5_000_000_000]]).rho == 1.0
    assert coordination(np.diag([2**62, 2**62, 2**62])).rho == 1.0


def test_leading_axes_are_kept():
    effect = coordination(np.ones((5, 7, 3, 3), dtype=int))
    assert effect.rho.shape == (5, 7)
    assert effect.q.shape == (5, 7, 3)
    assert coordination(np.zeros((0, 2, 2), dtype=int)).delta.shape == (0,)


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([[1, -1], [0, 1]], "contain -1"),
        ([[1.5, 1], [0, 1]], "not integers"),
        ([[np.nan, 1], [0, 1]], "NaN"),
        ([[5]], "K=1"),
        ([[1, 2, 3], [1, 2, 3]], "shape"),
        ([1, 2, 3], "shape"),
        ([["a", "b"], ["c", "d"]], "dtype"),
        ([[1e17, 0], [0, 1]], "not integers"),
        (np.array([[1, "x"], [0, 1]], dtype=object), "not integers"),
    ],
)
def test_tables_that_are_not_counts_are_refused_in_one_sentence(counts, message):
    with pytest.raises(ValueError, match=message) as error:
        coordination(counts)
    assert "\n" not in str(error.value)
