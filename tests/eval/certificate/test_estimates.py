"""A certificate's estimates are unbiased, exact in integers, and the report's own."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import stream

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.effects.unbiased import unbiased_coordination


@pytest.mark.parametrize("n", [4, 6])
@pytest.mark.parametrize("k", [2, 3])
def test_the_product_of_diversities_compares_disjoint_draws(n, k):
    rng = np.random.default_rng(n * k)
    for _ in range(20):
        a, b = rng.integers(0, k, size=(2, n))
        quadruples = list(permutations(range(n), 4))
        expected = np.mean([a[i] != a[j] and b[x] != b[y] for i, j, x, y in quadruples])
        table = unbiased_coordination(joint_counts(a, b, k)[:-1, :-1])
        assert table.product == pytest.approx(expected, abs=1e-12)
        certificate = CoordinationCertificate(n_modes=k)
        certificate.update(a[None], b[None])
        assert certificate.capacity**2 == pytest.approx(min(expected, table.diversity_q * table.diversity_p), abs=1e-12)


def test_the_unbiased_estimates_of_eight_billion_pairs_do_not_overflow():
    billion = 10**9
    table = unbiased_coordination([[3 * billion, billion], [billion, 3 * billion]])
    assert table.n == 8 * billion
    assert table.delta == pytest.approx(0.25, abs=1e-9)
    assert table.product == pytest.approx(0.25, abs=1e-9)


def test_estimates_are_the_means_of_the_unbiased_tables():
    a, b = stream(decisions=300, n=5, couple=0.5, invalid=0.3, k=3)
    certificate = CoordinationCertificate(n_modes=3)
    certificate.update(a, b)
    tables = unbiased_coordination(joint_counts(a, b, 3)[:, :-1, :-1])
    usable = tables.n >= 2
    assert certificate.reading.used == usable.sum()
    assert certificate.delta == pytest.approx(tables.delta[usable].mean(), abs=1e-12)
    assert certificate.capacity == pytest.approx(tables.capacity, abs=1e-12)
    assert certificate.valid_rate == pytest.approx(((a >= 0) & (b >= 0)).mean(), abs=1e-12)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4), st.integers(2, 6))
def test_unbiased_estimates_compare_matched_with_mismatched_pairs(seed, k, n):
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, k, size=(2, n))
    table = unbiased_coordination(joint_counts(a, b, k)[:-1, :-1])
    mismatched = [(i, j) for i in range(n) for j in range(n) if i != j]
    expected = np.mean(a == b) - np.mean([a[i] == b[j] for i, j in mismatched])
    assert table.delta == pytest.approx(expected, abs=1e-12)
    assert table.diversity_q == pytest.approx(1 - np.mean([a[i] == a[j] for i, j in mismatched]), abs=1e-12)
    plug_in = coordination(joint_counts(a, b, k)[:-1, :-1])
    assert table.delta == pytest.approx(plug_in.delta * n / (n - 1), abs=1e-12)
    assert table.diversity_p == pytest.approx(plug_in.diversity_p * n / (n - 1), abs=1e-12)


def test_unbiased_estimates_have_the_right_mean_from_two_pairs():
    joint = np.array([[0.4, 0.2], [0.1, 0.3]])
    a, b = np.divmod(np.random.default_rng(0).choice(4, p=joint.ravel(), size=(200_000, 2)), 2)
    tables = unbiased_coordination(joint_counts(a, b, 2)[:, :-1, :-1])
    truth = coordination((joint * 10).astype(int))
    for name in ("delta", "diversity_q", "diversity_p"):
        sample = getattr(tables, name)
        assert abs(sample.mean() - getattr(truth, name)) < 4 * sample.std() / np.sqrt(sample.size)


def test_the_valid_rate_lies_inside_its_own_bounds_when_the_number_of_pairs_varies():
    certificate = CoordinationCertificate()
    certificate.update(np.zeros((2000, 2), dtype=int), np.zeros((2000, 2), dtype=int))
    certificate.update(np.full((2000, 64), -1), np.full((2000, 64), -1))
    assert certificate.valid_rate == 0.5
    assert certificate.valid_rate in certificate.bounds["valid_rate"]
