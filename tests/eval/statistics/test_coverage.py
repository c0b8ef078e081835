"""Simulation studies: intervals cover at their rate, and time-uniform bounds are missed no more than alpha.

Minutes of simulation; run with ``uv run pytest -m slow -s tests/eval/statistics/test_coverage.py`` to see the tables.
"""

import numpy as np
import pytest
from scipy.stats import beta

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.statistics.bootstrap import bootstrap_conditions
from dualhead_eval.statistics.bootstrap_variants import bca_interval, studentised_interval
from dualhead_eval.statistics.confidence_sequence import boundary, log_mixture, mixture_rho
from dualhead_eval.statistics.run_statistics import condition_sums

pytestmark = pytest.mark.slow

DECISIONS, STREAMS, ALPHA = 10_000, 2000, 0.05


def laws(kind, streams, rng):
    """Each decision's left frequencies of both heads, coupling and validity, ``(streams, DECISIONS)``."""
    t = np.arange(DECISIONS) / DECISIONS
    one = np.ones((streams, DECISIONS))
    phase = rng.random((streams, 1))
    if kind == "still":
        return 0.5 * one, 0.5 * one, 0.3 * one, 0.9 * one
    if kind == "drifting":
        left = 0.5 + 0.45 * np.sin(2 * np.pi * (3 * t + phase))
        return (
            left,
            np.roll(left, 500, axis=1),
            0.5 + 0.5 * np.sin(2 * np.pi * (t + phase)),
            0.6 + 0.4 * t * one,
        )
    if kind == "switching":
        left = np.where((t + phase) % 0.5 < 0.25, 0.98, 0.3)
        return left, left, np.where((t + phase) % 1 < 0.5, 0.0, 1.0), np.where(t < 0.5, 1.0, 0.5) * one
    left = rng.beta(0.5, 0.5, size=(streams, DECISIONS))
    return left, left, rng.random((streams, DECISIONS)), 0.8 * one


def sample(left_a, left_b, couple, valid, rng):
    """Two sample pairs a decision: labels ``(streams, DECISIONS, 2)`` of each head."""
    shape = (*left_a.shape, 2)
    shared, a_own, b_own = rng.random((3, *shape), dtype=np.float32)
    together = rng.random(shape, dtype=np.float32) < couple[..., None]
    a = (np.where(together, shared, a_own) >= left_a[..., None]).astype(np.int8)
    b = (np.where(together, shared, b_own) >= left_b[..., None]).astype(np.int8)
    root = np.sqrt(valid)[..., None]
    a[rng.random(shape, dtype=np.float32) >= root] = -1
    b[rng.random(shape, dtype=np.float32) >= root] = -1
    return a, b


def crossed(x, mean, included, low, high, alpha):
    """Whether a stream's bounds ever miss the running mean of ``mean`` over the included decisions."""
    count = included.cumsum(axis=1)
    total = np.where(included, x, 0).cumsum(axis=1)
    before = total - np.where(included, x, 0)
    guess = (before + 0.5 * (low + high)) / np.maximum(count, 1)
    v = np.where(included, (x - guess) ** 2, 0).cumsum(axis=1)
    s = np.abs(np.where(included, x - mean, 0).cumsum(axis=1))
    # The mixture is at most exp(s^2 / 2v), so only these can have crossed.
    candidates = s**2 >= 2 * v * np.log(1 / alpha)
    missed = np.zeros(len(x), dtype=bool)
    rho = mixture_rho(alpha)
    rows, columns = np.nonzero(candidates & (count > 0))
    over = log_mixture(s[rows, columns], v[rows, columns], high - low, rho) >= np.log(1 / alpha)
    missed[rows[over]] = True
    return missed, s[:, -1], v[:, -1], count[:, -1]


@pytest.mark.parametrize("kind", ["still", "drifting", "switching", "rough"])
def test_the_certificates_bounds_miss_no_more_than_alpha_of_all_streams(kind):
    rng = np.random.default_rng(20260802)
    missed, chunk, side = 0, 50, ALPHA / 10
    for start in range(0, STREAMS, chunk):
        left_a, left_b, couple, valid = laws(kind, chunk, rng)
        a, b = sample(left_a, left_b, couple, valid, rng)
        both = (a >= 0) & (b >= 0)
        used = both.all(axis=-1)
        agree = (a == b).mean(axis=-1)
        x_delta = agree - 0.5 * ((a[..., 0] == b[..., 1]) + (a[..., 1] == b[..., 0]).astype(float))
        x_q, x_p = (m[..., 0] != m[..., 1] for m in (a, b))
        union = np.minimum(left_a, left_b) + np.minimum(1 - left_a, 1 - left_b)
        chance = left_a * left_b + (1 - left_a) * (1 - left_b)
        always = np.ones_like(used)
        quantities = {
            "delta": (x_delta, couple * (union - chance), used, -1, 1),
            "diversity_q": (x_q.astype(float), 2 * left_a * (1 - left_a), used, 0, 1),
            "diversity_p": (x_p.astype(float), 2 * left_b * (1 - left_b), used, 0, 1),
            "valid_rate": (both.mean(axis=-1), valid, always, 0, 1),
        }
        wrong = np.zeros(chunk, dtype=bool)
        last = {}
        for name, arguments in quantities.items():
            missed_here, *last[name] = crossed(*arguments, side)
            wrong |= missed_here
        missed += int(wrong.sum())
        if start == 0:
            certificate = CoordinationCertificate(alpha=ALPHA)
            certificate.update(a[0].astype(int), b[0].astype(int))
            for name, (_, v, count) in last.items():
                x, _, included, low, high = quantities[name]
                u = boundary(v[0], side, high - low) / count[0]
                centre = x[0][included[0]].mean()
                interval = certificate.bounds[name]
                inner = (-0.5, 0.5) if name == "delta" else (0, 0.5) if "diversity" in name else (0, 1)
                expected = max(inner[0], centre - u), min(inner[1], centre + u)
                assert (interval.low, interval.high) == pytest.approx(expected, abs=1e-9)
    lower = beta.ppf(0.025, missed, STREAMS - missed + 1) if missed else 0.0
    print(f"\n{kind}: {missed} of {STREAMS} streams missed at some time, 95% lower limit {lower:.4f}")
    assert lower <= ALPHA


@pytest.mark.parametrize("kind", ["still", "drifting", "switching", "rough", "one head collapsed"])
def test_bounds_from_four_pairs_contain_the_mean_capacity_and_rho_at_all_times(kind):
    """Read at sixty moments: the mean of sqrt(G(q) G(p)) over the decisions used so far, and delta over it."""
    rng = np.random.default_rng(20260802)
    streams, ends = 400, np.unique(np.geomspace(20, DECISIONS, 60).astype(int))
    wrong = 0
    for _ in range(streams):
        if kind == "one head collapsed":
            even = np.arange(DECISIONS)[None] % 2 == 0
            left_a, left_b = np.where(even, 1.0, 0.5), np.where(even, 0.5, 1.0)
            couple, valid = np.full(left_a.shape, 0.3), np.full(left_a.shape, 0.9)
        else:
            left_a, left_b, couple, valid = laws(kind, 1, rng)
        twice = [sample(left_a, left_b, couple, valid, rng) for _ in range(2)]
        a, b = (np.concatenate([pairs[head][0] for pairs in twice], axis=-1) for head in range(2))
        used = ((a >= 0) & (b >= 0)).sum(axis=-1) >= 2
        union = np.minimum(left_a, left_b) + np.minimum(1 - left_a, 1 - left_b)
        chance = left_a * left_b + (1 - left_a) * (1 - left_b)
        capacity = 2 * np.sqrt(left_a * (1 - left_a) * left_b * (1 - left_b))[0]
        delta = (couple * (union - chance))[0]
        certificate = CoordinationCertificate(alpha=ALPHA)
        missed = False
        for start, end in zip([0, *ends[:-1]], ends, strict=True):
            certificate.update(a[start:end].astype(int), b[start:end].astype(int))
            if not used[:end].any():
                continue
            mean_c, mean_d = capacity[:end][used[:end]].mean(), delta[:end][used[:end]].mean()
            bounds = certificate.bounds
            missed |= not bounds["capacity"].low - 1e-12 <= mean_c <= bounds["capacity"].high + 1e-12
            missed |= not bounds["delta"].low - 1e-12 <= mean_d <= bounds["delta"].high + 1e-12
            if mean_c > 0:
                missed |= not bounds["rho"].low - 1e-12 <= mean_d / mean_c <= bounds["rho"].high + 1e-12
        wrong += missed
    lower = beta.ppf(0.025, wrong, streams - wrong + 1) if wrong else 0.0
    print(f"\n{kind}: {wrong} of {streams} streams missed at some time, 95% lower limit {lower:.4f}")
    assert lower <= ALPHA


def conditions(n, rng, pairs=1280):
    """Random conditions: mode priors, coupling and validity vary; returns tables and true terms."""
    left = rng.beta(4, 4, size=n)
    couple = rng.beta(2, 2, size=n)
    valid = rng.beta(8, 2, size=n)
    same = couple + (1 - couple) * (left**2 + (1 - left) ** 2)
    cells = np.stack(
        [
            valid * (couple * left + (1 - couple) * left**2),
            valid * (1 - couple) * left * (1 - left),
            valid * (1 - couple) * left * (1 - left),
            valid * (couple * (1 - left) + (1 - couple) * (1 - left) ** 2),
            1 - valid,
        ],
        axis=1,
    )
    drawn = rng.multinomial(pairs, cells)
    table = np.zeros((n, 3, 3), dtype=np.int64)
    table[:, :2, :2] = drawn[:, :4].reshape(n, 2, 2)
    table[:, 2, 2] = drawn[:, 4]
    capacity = 2 * left * (1 - left)
    return table, np.array(
        [(valid * couple * capacity).sum(), (valid * capacity).sum(), valid.sum(), (valid * (1 - same)).sum()]
    )


@pytest.mark.parametrize(("n", "required"), [(75, 0.92), (36, 0.90)])
def test_nominal_95_percent_intervals_cover(n, required):
    rng = np.random.default_rng(7)
    truth_terms = conditions(2_000_000, rng)[1]
    truth = {
        "rho": truth_terms[0] / truth_terms[1],
        "delta": truth_terms[0] / truth_terms[2],
        "obs": truth_terms[3] / truth_terms[2],
        "capacity": truth_terms[1] / truth_terms[2],
    }
    repeats = 1000
    hits = {(kind, name): 0 for kind in ("percentile", "BCa", "studentised") for name in truth}
    for _ in range(repeats):
        sums = condition_sums(conditions(n, rng)[0])
        percentile = bootstrap_conditions(sums, draws=1000, rng=rng)
        for name, value in truth.items():
            hits["percentile", name] += value in percentile.interval(name, 0.95)
            hits["BCa", name] += value in bca_interval(sums, name, draws=1000, rng=rng)
            hits["studentised", name] += value in studentised_interval(sums, name, draws=1000, rng=rng)
    print(f"\ncoverage of nominal 95% intervals, {n} conditions, {repeats} repeats")
    for kind in ("percentile", "BCa", "studentised"):
        print(f"  {kind:12s}" + "".join(f"  {name} {hits[kind, name] / repeats:.3f}" for name in truth))
    for count in hits.values():
        assert count / repeats >= required
