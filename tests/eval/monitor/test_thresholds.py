"""Thresholds keep their rate of false alarms, by the definition of the k-th smallest and by simulation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from dualhead_eval.monitor.thresholds.conformal import SplitConformal
from dualhead_eval.monitor.thresholds.functional_band import FunctionalBand
from dualhead_eval.monitor.thresholds.mondrian import Mondrian
from dualhead_eval.monitor.thresholds.registry import make_threshold
from dualhead_eval.monitor.thresholds.threshold import Trace, conformal_quantile, needed_episodes


@given(st.integers(1, 300), st.sampled_from([0.05, 0.1, 0.2, 1 / 3]))
def test_the_threshold_is_the_kth_smallest_and_infinite_beyond_the_last(n, alpha):
    scores = np.random.default_rng(n).permutation(n).astype(float)
    limit = conformal_quantile(scores, alpha)
    # The smallest order statistic of rank k with k / (n + 1) >= 1 - alpha.
    ranks = [k for k in range(1, n + 1) if k >= (n + 1) * (1 - alpha) - 1e-9]
    assert limit == (ranks[0] - 1 if ranks else np.inf)
    assert (n >= needed_episodes(alpha)) == np.isfinite(limit)


@pytest.mark.parametrize("n", [50, 200, 1000])
def test_split_conformal_covers_within_its_binomial_interval(n):
    """Of exchangeable scores a further one exceeds the threshold with probability 1 - k / (n + 1)."""
    rng, alpha, streams = np.random.default_rng(n), 0.05, 4000
    scores = rng.standard_t(3, size=(streams, n + 1))
    limits = np.array([conformal_quantile(row[:n], alpha) for row in scores])
    exceeded = int((scores[:, n] > limits).sum())
    exact = 1 - np.ceil((n + 1) * (1 - alpha)) / (n + 1)
    assert exact <= alpha
    low, high = binom.interval(0.999, streams, exact)
    assert low <= exceeded <= high


def episodes(rng, count, level=0.3):
    """Traces of 4 to 9 decisions that share a level within the episode, and rise with time."""
    made = []
    for _ in range(count):
        length = rng.integers(4, 10)
        values = level * rng.standard_normal() + 0.1 * np.arange(length) + 0.2 * rng.standard_normal(length)
        made.append(Trace(values, rng.random(length) < 0.3))
    return made


def false_alarm_rate(threshold, calibration, streams, alpha=0.1, seed=0):
    """Share of further episodes with an alarm at any time, each under a threshold of its own."""
    rng, alarms = np.random.default_rng(seed), 0
    for _ in range(streams):
        threshold.fit(episodes(rng, calibration), alpha, rng)
        (further,) = episodes(rng, 1)
        alarms += any(value > threshold.at(i) for i, value in enumerate(further.values))
    return alarms


@pytest.mark.parametrize("threshold", [SplitConformal(), *(FunctionalBand(m) for m in ("const", "stdev", "tfunc"))])
def test_an_episode_raises_a_false_alarm_at_most_at_the_rate(threshold):
    streams = 400
    alarms = false_alarm_rate(threshold, 39, streams)
    assert alarms <= binom.ppf(0.999, streams, 0.1)
    assert alarms > 0
    assert "at most 0.1" in threshold.guarantee


@pytest.mark.slow
@pytest.mark.parametrize("calibration", [21, 32, 62, 202])
@pytest.mark.parametrize("threshold", [SplitConformal(), FunctionalBand("tfunc"), FunctionalBand("stdev")])
def test_ten_thousand_episodes_raise_no_more_false_alarms_than_promised(threshold, calibration):
    streams = 10_000
    alarms = false_alarm_rate(threshold, calibration, streams, alpha=0.05)
    print(f"\n{threshold.name} {threshold.options()}: {alarms / streams:.2%} of {streams} at {calibration} episodes")
    assert alarms <= binom.ppf(0.999, streams, 0.05)
    assert threshold.needed(0.05) <= calibration


def test_one_random_decision_raises_a_false_alarm_at_most_at_the_rate_and_pooled_steps_promise_nothing():
    rng, alarms, streams = np.random.default_rng(1), 0, 600
    threshold = SplitConformal("random-step")
    for _ in range(streams):
        threshold.fit(episodes(rng, 19), 0.1, rng)
        (further,) = episodes(rng, 1)
        alarms += rng.choice(further.values) > threshold.at(0)
    assert alarms <= binom.ppf(0.999, streams, 0.1)
    pooled = SplitConformal("paper-step")
    pooled.fit(traces := episodes(rng, 40), 0.1, rng)
    assert pooled.guarantee.startswith("none")
    assert pooled.at(0) == conformal_quantile(np.concatenate([trace.values for trace in traces]), 0.1)


def test_mondrian_calibrates_flagged_and_other_decisions_apart():
    rng = np.random.default_rng(2)
    traces = []
    for _ in range(60):
        flagged = np.arange(6) == 2
        traces.append(Trace(rng.random(6) + 10 * flagged, flagged))
    threshold = Mondrian()
    threshold.fit(traces, 0.1, rng)
    assert threshold.at(2, True) > 10 > 1 >= threshold.at(0, False)
    assert threshold.at(2, True) == conformal_quantile([trace.values[2] for trace in traces], 0.1)
    with pytest.raises(ValueError, match="flag"):
        threshold.fit([Trace(trace.values) for trace in traces], 0.1, rng)
    with pytest.raises(ValueError, match="without a flag"):
        threshold.at(0)
    with pytest.raises(ValueError, match="0 calibration episodes have decisions with the flag true"):
        threshold.fit([Trace(trace.values, ~trace.values.astype(bool)) for trace in traces], 0.1, rng)


def test_the_band_holds_its_last_value_and_follows_the_spread():
    rng = np.random.default_rng(3)
    traces = [Trace(np.array([0.0, 1.0, 5.0]) * rng.standard_normal()) for _ in range(80)]
    band = FunctionalBand("stdev")
    band.fit(traces, 0.1, rng)
    assert band.at(2) > band.at(1) > band.at(0)
    assert band.at(50) == band.at(2)


def test_a_diverged_calibration_episode_makes_a_threshold_infinite_only_where_it_must():
    traces = [Trace(np.array([float(i)])) for i in range(39)] + [Trace(np.array([np.inf]))]
    threshold = SplitConformal()
    threshold.fit(traces, 0.1, np.random.default_rng(0))
    assert threshold.at(0) == 36
    threshold.fit(traces, 0.02, np.random.default_rng(0))
    assert threshold.at(0) == np.inf


@pytest.mark.parametrize(
    ("name", "message"),
    [("conformal:step", "unit"), ("band:sd", "modulation"), ("mondrian:x", "unit"), ("cp", "known")],
)
def test_unknown_thresholds_are_named(name, message):
    with pytest.raises(ValueError, match=message):
        make_threshold(name)


@pytest.mark.parametrize("name", ["conformal:random-step", "band:tfunc", "mondrian"])
def test_a_threshold_is_restored_from_what_it_learned(name):
    rng = np.random.default_rng(4)
    fitted, restored = make_threshold(name), make_threshold(name)
    fitted.fit(episodes(rng, 60), 0.1, rng)
    restored.restore(fitted.learned())
    assert [restored.at(i, i % 2 == 0) for i in range(12)] == [fitted.at(i, i % 2 == 0) for i in range(12)]


def test_scores_that_are_not_numbers_are_refused():
    with pytest.raises(ValueError, match="NaN"):
        conformal_quantile([1.0, np.nan], 0.1)
    with pytest.raises(ValueError, match="alpha"):
        conformal_quantile([1.0], 1.0)
    with pytest.raises(ValueError, match="at least 4"):
        FunctionalBand().fit([Trace(np.ones(3))] * 3, 0.1, np.random.default_rng(0))
