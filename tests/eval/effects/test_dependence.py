"""Mutual information, entropies and what an effect certifies; the head-valid approximation's excursions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from sklearn.metrics import mutual_info_score

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.dependence import (
    diversity_from_effect,
    entropy,
    frequency_range_from_effect,
    mutual_information,
)
from dualhead_eval.effects.head_valid import head_valid_coordination


@settings(max_examples=200, deadline=None)
@given(st.integers(2, 6).flatmap(lambda k: arrays(np.int64, (k, k), elements=st.integers(0, 10_000))))
def test_mutual_information_is_scikit_learns(table):
    if table.sum() == 0:
        assert np.isnan(mutual_information(table))
        return
    assert mutual_information(table) == pytest.approx(mutual_info_score(None, None, contingency=table), abs=1e-12)


def test_entropy_is_scipys():
    frequencies = np.array([[0.5, 0.5, 0], [0.2, 0.3, 0.5]])
    np.testing.assert_allclose(entropy(frequencies), stats.entropy(frequencies, axis=-1), atol=1e-15)


def test_perfect_dependence_off_the_diagonal_has_information_ln_3():
    """sec:calculus: fix one label of three and swap the others; delta is 0, the information is ln 3."""
    table = [[100, 0, 0], [0, 0, 100], [0, 100, 0]]
    assert coordination(table).delta == 0
    assert mutual_information(table) == pytest.approx(np.log(3))


def test_the_papers_certificate_example():
    """sec:calculus: delta = 0.4710 certifies G(q) >= 0.4436 and q in [0.332, 0.668]."""
    # 2 * 0.4710^2 = 0.44368, which the paper truncates.
    assert np.floor(diversity_from_effect(0.4710, 2) * 1e4) / 1e4 == 0.4436
    assert np.round(frequency_range_from_effect(0.4710), 3).tolist() == [0.332, 0.668]
    with pytest.raises(ValueError, match="outside"):
        frequency_range_from_effect(0.6)


@given(st.integers(1, 1000), st.integers(0, 1000), st.integers(0, 1000), st.integers(1, 1000))
def test_the_certified_range_contains_the_frequency(a, b, c, d):
    effect = coordination([[a, b], [c, d]])
    low, high = frequency_range_from_effect(effect.delta)
    for frequency in (effect.q[0], effect.p[0]):
        assert low - 1e-9 <= frequency <= high + 1e-9


@settings(max_examples=200, deadline=None)
@given(arrays(np.int64, (3, 3), elements=st.integers(0, 500)))
def test_head_valid_equals_exact_when_every_sample_is_valid(table):
    padded = np.pad(table, (0, 1))
    approximate, exact = head_valid_coordination(padded), coordination(table)
    for name in ("delta", "capacity", "capacity_tight"):
        assert getattr(approximate, name) == pytest.approx(getattr(exact, name), abs=1e-12, nan_ok=True)
    assert not approximate.above_capacity
    assert not approximate.above_tight


def test_a_collapsed_head_leaves_the_region_under_head_valid_marginals_only():
    """The logic of tab:caliber's posterior row: rho above 1 head-valid, exactly 1 both-valid."""
    rng = np.random.default_rng(0)
    tables = np.zeros((75, 3, 3), dtype=np.int64)
    rare = rng.integers(5, 25, size=75)
    tables[:, 0, 0] = 1000
    tables[:, 1, 1] = rare
    # Head B often fails where head A takes the rare mode: head A's own marginal counts those samples.
    tables[:, 1, 2] = rare
    approximate = head_valid_coordination(tables)
    exact = coordination(tables[:, :2, :2])
    run = approximate.run()
    assert run["rho"] > 1
    assert run["above_capacity"] == run["above_tight"] == 75
    np.testing.assert_array_equal(exact.delta, exact.capacity)
    np.testing.assert_array_equal(exact.rho, 1.0)
    assert run["delta"] == pytest.approx(np.average(approximate.delta, weights=exact.n))


def test_independent_heads_are_on_the_floor_under_both_accountings():
    rng = np.random.default_rng(1)
    q, p = rng.dirichlet([3, 3, 1], size=(2, 75))
    tables = np.array([np.outer(1000 * a, b * 1000).round().astype(int) for a, b in zip(q, p, strict=True)])
    run = head_valid_coordination(tables).run()
    assert abs(run["rho"]) < 1e-3
    assert run["above_capacity"] == 0


def test_without_a_valid_pair_the_approximation_is_undefined_too():
    run = head_valid_coordination([[[0, 0, 5], [0, 0, 5], [5, 5, 5]]]).run()
    assert np.isnan(run["delta"])
    assert np.isnan(run["rho"])
