"""Statistics of many episodes at once against LeRobot's own, one episode at a time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from lerobot.datasets.compute_stats import aggregate_stats, get_feature_stats

from dualhead_envs.recording.statistics import aggregate, episode_statistics


def arrays(dtype, elements):
    shapes = st.tuples(st.integers(1, 3), st.integers(1, 20), st.integers(1, 3))
    return hnp.arrays(dtype, shapes, elements=elements)


def assert_as_lerobot(values):
    ours = episode_statistics(values)
    theirs = [get_feature_stats(episode, axis=0, keepdims=False) for episode in values]
    for i, statistics in enumerate(theirs):
        assert statistics.keys() == ours.keys()
        for key, value in statistics.items():
            np.testing.assert_allclose(ours[key][i], value, rtol=1e-6, atol=1e-9, err_msg=key)
    together = aggregate_stats([{"x": statistics} for statistics in theirs])["x"]
    for key, value in aggregate(ours).items():
        np.testing.assert_allclose(value, together[key], rtol=1e-5, atol=1e-6, err_msg=key)


@given(arrays(np.float32, st.floats(-2, 2, width=32)))
@settings(max_examples=60, deadline=None)
def test_single_precision_features(values):
    assert_as_lerobot(values)


@given(arrays(np.float32, st.sampled_from([-1.0, 0.0, 0.5, 1.0])))
@settings(max_examples=40, deadline=None)
def test_features_with_ties_and_constants(values):
    assert_as_lerobot(values)


@given(arrays(np.int64, st.integers(0, 10**6)))
@settings(max_examples=40, deadline=None)
def test_integer_features(values):
    assert_as_lerobot(values)


@pytest.mark.parametrize("length", [16, 300])
def test_timestamps_and_running_indices(length):
    frame = np.arange(length)
    for values in (frame / 20, frame, frame + 10**7, np.full(length, 123_456)):
        assert_as_lerobot(values[None, :, None])
