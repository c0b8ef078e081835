"""The bounds of a certificate: the boundary of a confidence sequence, and what boxes of frequencies allow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import linprog
from streams import stream

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate.pooled_bounds import chance_bounds, gini_bounds, simplex_box
from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.effects.unbiased import unbiased_coordination
from dualhead_eval.statistics.confidence_sequence import RunningMean, boundary, log_mixture, mixture_rho


@pytest.mark.parametrize("n", [2, 4, 8])
def test_capacity_is_bounded_from_both_sides(n):
    """Half of the decisions at (0.5, 0.5), half at (0.5, 0.1): C is the mean of 0.5 and 0.3."""
    rng = np.random.default_rng(0)
    left_b = np.where(np.arange(30_000) % 2 == 0, 0.5, 0.1)[:, None]
    a, b = rng.random((30_000, n)) < 0.5, rng.random((30_000, n)) < left_b
    certificate = CoordinationCertificate()
    certificate.update(a.astype(int), b.astype(int))
    bounds = certificate.bounds["capacity"]
    assert bounds.low < 0.4 < bounds.high
    assert bounds.high - bounds.low < 0.15
    assert certificate.capacity >= 0.395


@pytest.mark.parametrize("n", [2, 16])
def test_the_bounds_are_tuned_to_the_pairs_of_a_decision(n):
    """At a thousand decisions the tuned boundary is the tightest of its family, within 5%."""
    a, b = stream(decisions=1000, n=n)
    certificate = CoordinationCertificate()
    certificate.update(a, b)
    mean = certificate._state.delta
    level = 0.05 / certificate._state.n_sequences
    widths = [np.ptp(mean.bounds(level, tuned)) for tuned in 250.0 / np.geomspace(0.25, 400, 40)]
    interval = certificate.bounds["delta"]
    assert interval.high - interval.low <= 1.05 * min(widths)


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize(("s", "v"), [(5, 10), (50, 300), (0, 3), (300, 5000)])
def test_the_boundary_is_the_gamma_exponential_mixture(scale, s, v):
    rho = mixture_rho(0.01)

    def integrand(x, s, v):
        return np.exp(((v + rho) / scale**2 - 1) * np.log1p(-scale * x) + x * (s + (v + rho) / scale))

    points = [max(0.0, s / (v + rho + scale * s))]
    top, bottom = (
        quad(integrand, 0, 1 / scale, args=args, limit=400, epsabs=0, points=points)[0] for args in ((s, v), (0, 0))
    )
    assert log_mixture(s, v, scale, rho) == pytest.approx(np.log(top / bottom), abs=1e-8)
    u = boundary(v, 0.01, scale)
    assert log_mixture(u, v, scale, rho) == pytest.approx(np.log(100), abs=1e-6)
    assert u >= np.sqrt(2 * v * np.log(100))


def test_bounds_at_ten_thousand_decisions_are_within_three_fixed_n_widths():
    a, b = stream(decisions=10_000, n=2, couple=0.5)
    certificate = CoordinationCertificate()
    certificate.update(a, b)
    tables = unbiased_coordination(joint_counts(a, b, 2)[:, :-1, :-1])
    fixed = 2 * 1.96 * tables.delta.std(ddof=1) / np.sqrt(10_000)
    interval = certificate.bounds["delta"]
    assert interval.high - interval.low <= 3 * fixed


@given(st.integers(0, 10**6), st.integers(2, 5))
def test_pooled_bounds_contain_every_point_of_their_boxes(seed, k):
    rng = np.random.default_rng(seed)
    q, p = rng.dirichlet(np.ones(k), size=2)
    q_box, p_box = (
        [(max(0, x - w), min(1, x + z)) for x, w, z in zip(m, *rng.random((2, k)) * 0.3, strict=True)] for m in (q, p)
    )
    low, high = chance_bounds(q_box, p_box)
    assert low - 1e-12 <= q @ p <= high + 1e-12
    low, high = gini_bounds(q_box)
    assert low - 1e-12 <= 1 - q @ q <= high + 1e-12


def test_pooled_bounds_of_four_even_modes_use_that_frequencies_sum_to_one():
    """Frequencies known to 0.05: without the simplex the chance agreement is known to 0.2, with it to 0.02."""
    box = [(0.2, 0.3)] * 4
    low, high = chance_bounds(box, box)
    assert high - low <= 0.0201
    low, high = gini_bounds(box)
    assert high == 0.75
    assert low >= 0.7399


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 5))
def test_the_box_of_frequencies_is_the_smallest_that_holds_the_simplex(seed, k):
    rng = np.random.default_rng(seed)
    centre = rng.dirichlet(np.ones(k))
    low, high = np.maximum(0, centre - 0.3 * rng.random(k)), np.minimum(1, centre + 0.3 * rng.random(k))
    tight = simplex_box(list(zip(low, high, strict=True)))
    for mode in range(k):
        for sign, end in zip((1, -1), tight[mode], strict=True):
            direction = sign * np.eye(k)[mode]
            best = linprog(direction, A_eq=np.ones((1, k)), b_eq=[1], bounds=list(zip(low, high, strict=True)))
            assert sign * best.fun == pytest.approx(end, abs=1e-9)


def test_a_running_mean_before_its_first_observation_knows_only_the_range():
    assert RunningMean(-1, 1).bounds(0.05) == (-1, 1)
