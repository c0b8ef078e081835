"""The certificate tells coordination from collapse, and never claims more than its bounds allow."""

import numpy as np
import pytest
from streams import stream

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate.reading import VERDICTS
from dualhead_eval.effects.sites import Occupancy, occupancy


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
