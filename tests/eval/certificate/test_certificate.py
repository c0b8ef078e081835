"""The certificate tells coordination from collapse, and never claims more than its bounds allow."""

import json
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import linprog

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate.pooled_bounds import chance_bounds, gini_bounds, simplex_box
from dualhead_eval.certificate.reading import VERDICTS
from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.effects.sites import Occupancy, occupancy
from dualhead_eval.effects.unbiased import unbiased_coordination
from dualhead_eval.statistics.confidence_sequence import RunningMean, boundary, log_mixture, mixture_rho


def stream(decisions=2000, n=4, couple=0.0, prior=0.5, invalid=0.0, flip=False, seed=0, k=2):
    rng = np.random.default_rng(seed)
    probabilities = [prior, 1 - prior] if k == 2 else np.full(k, 1 / k)
    draw = lambda: rng.choice(k, p=probabilities, size=(decisions, n))  # noqa: E731
    a = draw()
    b = np.where(rng.random(a.shape) < couple, (a + flip) % k, draw())
    return tuple(np.where(rng.random(a.shape) < invalid, -1, x) for x in (a, b))


@pytest.mark.parametrize(
    ("kwargs", "verdict"),
    [
        ({"couple": 0.9}, "coordinated"),
        ({"couple": 0.9, "k": 4}, "coordinated"),
        ({"couple": 0.9, "flip": True}, "anti-coordinated"),
        ({"decisions": 10_000, "n": 16}, "uncoordinated"),
        ({"prior": 0.999, "couple": 1.0}, "collapsed"),
        ({"invalid": 0.5}, "low-validity"),
        ({"decisions": 5, "couple": 0.9}, "insufficient"),
    ],
)
def test_each_verdict_from_its_own_stream(kwargs, verdict):
    certificate = CoordinationCertificate(n_modes=kwargs.get("k", 2))
    certificate.update(*stream(**kwargs))
    assert certificate.verdict == verdict
    assert verdict in VERDICTS


def test_zero_mismatch_is_coordination_or_collapse_and_the_certificate_says_which():
    both, one = (CoordinationCertificate() for _ in range(2))
    a, _ = stream(couple=1.0)
    both.update(a, a)
    one.update(np.zeros_like(a), np.zeros_like(a))
    assert both.verdict == "coordinated"
    assert one.verdict == "collapsed"
    assert np.isnan(one.rho)
    assert one.delta == 0


def test_conditions_that_move_both_heads_cannot_fake_coordination():
    """Within a decision the heads are independent; across decisions their marginals move together."""
    rng = np.random.default_rng(0)
    left = np.where(np.arange(8000) % 2 == 0, 0.8, 0.2)[:, None]
    a, b = ((rng.random((8000, 4)) > left).astype(int) for _ in range(2))
    conditional = CoordinationCertificate(margin=0.10)
    conditional.update(a, b)
    assert conditional.verdict == "uncoordinated"
    assert 0 in conditional.bounds["delta"]
    pooled = CoordinationCertificate()
    pooled.update(a[:, 0], b[:, 0])
    assert pooled.bounds["delta"].low > 0.05
    assert pooled.verdict == "insufficient"
    assert pooled.reading.kind == "pooled"
    assert "Simpson" in pooled.reading.reason
    assert "Simpson" in pooled.reading.guarantee


@pytest.mark.parametrize("couple", [0.0, 0.9])
def test_single_pairs_never_say_how_the_heads_choose_within_a_decision(couple):
    certificate = CoordinationCertificate()
    a, b = stream(decisions=60_000, n=1, couple=couple)
    for part in np.array_split(np.arange(len(a)), 30):
        certificate.update(a[part], b[part])
        assert certificate.verdict == "insufficient"
    assert (0 in certificate.bounds["delta"]) == (couple == 0)


@pytest.mark.parametrize(("kwargs", "verdict"), [({"prior": 0.999}, "collapsed"), ({"invalid": 0.5}, "low-validity")])
def test_single_pairs_do_show_collapse_and_invalidity(kwargs, verdict):
    """Pooled diversity is at least the decisions' own, so where it is small, so are they."""
    certificate = CoordinationCertificate()
    certificate.update(*stream(decisions=20_000, n=1, **kwargs))
    assert certificate.verdict == verdict


def one_head_collapsed_in_every_decision(decisions, n, seed=0):
    """Head A never varies in even decisions, head B never in odd ones: C is zero in each."""
    a, b = np.random.default_rng(seed).integers(0, 2, size=(2, decisions, n))
    a[::2], b[1::2] = 0, 0
    return a, b


def test_four_pairs_a_decision_show_that_one_head_has_always_collapsed():
    certificate = CoordinationCertificate()
    certificate.update(*one_head_collapsed_in_every_decision(8000, 4))
    assert certificate.reading.diversity_q == pytest.approx(0.25, abs=0.01)
    assert certificate.capacity < 0.02
    assert certificate.bounds["capacity"].high < 0.1
    assert certificate.verdict == "collapsed"


@pytest.mark.parametrize("n", [2, 3])
def test_fewer_than_four_pairs_cannot_exclude_that_one_head_has_collapsed(n):
    certificate = CoordinationCertificate()
    certificate.update(*one_head_collapsed_in_every_decision(60_000, n))
    assert certificate.bounds["capacity"].low == 0
    assert certificate.verdict == "insufficient"
    assert "collapse of one head in every decision cannot be excluded" in certificate.reading.reason


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


def test_the_report_and_the_certificate_use_one_vocabulary():
    """The words of a long stream are those of its site, whichever the coupling."""
    sites = {0.0: "I", 0.2: "III", 0.95: "IV"}
    for couple, numeral in sites.items():
        a, b = stream(decisions=12_000, n=16, couple=couple)
        certificate = CoordinationCertificate()
        certificate.update(a, b)
        site = occupancy(certificate.rho, certificate.capacity, 2)
        assert site.site == numeral
        assert certificate.verdict == site.verdict
        assert certificate.reading.occupancy is site
        assert site.word in repr(certificate)
    assert {site.verdict for site in Occupancy} < set(VERDICTS)


def test_capacity_is_examined_before_rho():
    a, b = stream(decisions=12_000, n=16, prior=0.99)
    certificate = CoordinationCertificate()
    certificate.update(a, b)
    assert certificate.verdict == "collapsed"
    assert occupancy(certificate.rho, certificate.capacity, 2).verdict == "collapsed"


def test_a_coordinated_stream_says_in_part_or_in_full_once_the_bounds_do():
    certificate = CoordinationCertificate()
    certificate.update(*stream(decisions=100, n=8, couple=0.95))
    assert certificate.verdict == "coordinated"
    assert certificate.reading.occupancy is None
    certificate.update(*stream(decisions=20_000, n=8, couple=0.95, seed=1))
    assert certificate.reading.occupancy is Occupancy.CORNER


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


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.booleans())
def test_how_a_stream_is_cut_into_updates_does_not_matter(sizes, single):
    a, b = stream(decisions=sum(sizes), n=1 if single else 3, couple=0.5, invalid=0.2)
    whole, parts = CoordinationCertificate(), CoordinationCertificate()
    whole.update(a, b)
    for x, y in zip(np.split(a, np.cumsum(sizes)[:-1]), np.split(b, np.cumsum(sizes)[:-1]), strict=True):
        parts.update(x, y)
    for name, interval in whole.bounds.items():
        assert parts.bounds[name].low == pytest.approx(interval.low, abs=1e-9)
        assert parts.bounds[name].high == pytest.approx(interval.high, abs=1e-9)
    assert parts.verdict == whole.verdict
    assert parts.delta == pytest.approx(whole.delta, abs=1e-12, nan_ok=True)


def test_the_valid_rate_lies_inside_its_own_bounds_when_the_number_of_pairs_varies():
    certificate = CoordinationCertificate()
    certificate.update(np.zeros((2000, 2), dtype=int), np.zeros((2000, 2), dtype=int))
    certificate.update(np.full((2000, 64), -1), np.full((2000, 64), -1))
    assert certificate.valid_rate == 0.5
    assert certificate.valid_rate in certificate.bounds["valid_rate"]


def test_no_stream_is_counted_twice(tmp_path):
    a, b = stream(decisions=50)
    certificate = CoordinationCertificate()
    certificate.update(a, b)
    certificate.save(tmp_path / "state.json")
    for copy in (certificate, CoordinationCertificate.load(tmp_path / "state.json")):
        with pytest.raises(ValueError, match="twice"):
            certificate.merge(copy)
    other = CoordinationCertificate()
    other.update(a, b)
    other.merge(certificate)
    with pytest.raises(ValueError, match="twice"):
        certificate.merge(other)
    assert certificate.reading.decisions == 50


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


def test_merging_processes_adds_their_streams():
    a, b = stream(decisions=4000, couple=0.9)
    whole, one, two = (CoordinationCertificate() for _ in range(3))
    whole.update(a, b)
    one.update(a[:2500], b[:2500])
    two.update(a[2500:], b[2500:])
    one.merge(two)
    assert one.reading.decisions == 4000
    assert one.delta == pytest.approx(whole.delta, abs=1e-12)
    assert one.verdict == whole.verdict == "coordinated"
    assert one.bounds["delta"].low == pytest.approx(whole.bounds["delta"].low, abs=2e-3)
    with pytest.raises(ValueError, match="alpha"):
        one.merge(CoordinationCertificate(alpha=0.1))
    single = CoordinationCertificate()
    single.update([0, 1], [0, 1])
    with pytest.raises(ValueError, match="one kind"):
        one.merge(single)


def test_a_saved_certificate_continues_as_if_nothing_happened(tmp_path):
    a, b = stream(decisions=500, couple=0.7, invalid=0.1)
    running, saved = CoordinationCertificate(), CoordinationCertificate()
    running.update(a, b)
    saved.update(a[:200], b[:200])
    saved.save(tmp_path / "state.json")
    loaded = CoordinationCertificate.load(tmp_path / "state.json")
    loaded.update(a[200:], b[200:])
    assert loaded.reading.delta == pytest.approx(running.reading.delta, abs=1e-12)
    assert loaded.verdict == running.verdict
    loaded.save(tmp_path / "state.json")
    assert CoordinationCertificate.load(tmp_path / "state.json").bounds == loaded.bounds


def test_memory_does_not_grow(tmp_path):
    small, large = CoordinationCertificate(), CoordinationCertificate()
    small.update(*stream(decisions=100))
    large.update(*stream(decisions=100_000))
    for certificate, name in ((small, "small"), (large, "large")):
        certificate.save(tmp_path / name)
    assert (tmp_path / "large").stat().st_size < 1.1 * (tmp_path / "small").stat().st_size < 5000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"format": "dualhead-cert', "truncated"),
        ('{"format": "dualhead-gate/1"}', "dualhead-gate/1"),
        ("[]", "None"),
        ('{"format": "dualhead-certificate/2", "state": {}}', "inconsistent"),
    ],
)
def test_foreign_certificates_are_refused(text, message, tmp_path):
    (tmp_path / "state.json").write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        CoordinationCertificate.load(tmp_path / "state.json")
    assert "\n" not in str(error.value)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        CoordinationCertificate.load(tmp_path / "absent.json")


def test_a_certificate_with_impossible_sums_is_refused(tmp_path):
    certificate = CoordinationCertificate()
    certificate.update(*stream(decisions=10))
    certificate.save(tmp_path / "state.json")
    document = json.loads((tmp_path / "state.json").read_text())
    document["state"]["modes_q"].pop()
    (tmp_path / "state.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match="inconsistent"):
        CoordinationCertificate.load(tmp_path / "state.json")


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        ([], [], "empty"),
        ([[]], [[]], "empty"),
        ([0, 1], [0], "shapes"),
        ([[[0]]], [[[0]]], "shapes"),
        ([0, 2], [0, 1], "label 2"),
        ([0.5], [0], "fractions"),
    ],
)
def test_labels_that_are_not_a_stream_are_refused(a, b, message):
    certificate = CoordinationCertificate()
    with pytest.raises(ValueError, match=message):
        certificate.update(a, b)
    assert certificate.reading.decisions == 0
    assert certificate.verdict == "insufficient"
    assert "too wide" in certificate.reading.reason


def test_single_pairs_and_several_pairs_do_not_mix():
    certificate = CoordinationCertificate()
    certificate.update([0, 1], [0, 1])
    with pytest.raises(ValueError, match="one kind"):
        certificate.update([[0, 1]], [[0, 1]])


@pytest.mark.parametrize("kwargs", [{"n_modes": 1}, {"alpha": 0}, {"margin": 2}, {"min_valid_rate": -1}])
def test_parameters_out_of_range_are_refused(kwargs):
    with pytest.raises(ValueError, match=next(iter(kwargs))):
        CoordinationCertificate(**kwargs)


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
