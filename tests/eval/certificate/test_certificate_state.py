"""A certificate is its sums: cut, merged, saved and read again they say the same; what is no stream is refused."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import stream

from dualhead_eval.certificate.certificate import CoordinationCertificate


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
