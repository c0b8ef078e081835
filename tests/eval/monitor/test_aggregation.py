"""Running aggregates are pandas' own."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualhead_eval.monitor.aggregation import AGGREGATES, Aggregator, running

SCORES = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30)


@given(SCORES)
def test_aggregates_are_those_of_pandas(scores):
    series = pd.Series(scores)
    expected = {
        "step": series,
        "ewma-max": series.ewm(alpha=0.1, adjust=False).mean().cummax(),
        "window-max": series.rolling(5, min_periods=1).max(),
        "window-mean": series.rolling(5, min_periods=1).mean(),
        "mean": series.expanding().mean(),
        "max": series.cummax(),
    }
    assert set(expected) == set(AGGREGATES)
    for name, values in expected.items():
        np.testing.assert_allclose(running(name, scores), values, rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("name", AGGREGATES)
def test_a_diverged_decision_ranks_above_all(name):
    assert running(name, [1.0, float("nan")])[-1] == np.inf
    assert running(name, [1.0, -np.inf])[-1] == np.inf


def test_an_aggregator_starts_anew_and_knows_its_names():
    aggregator = Aggregator("max")
    aggregator.add(5.0)
    aggregator.reset()
    assert aggregator.add(1.0) == 1.0
    with pytest.raises(ValueError, match="not known"):
        Aggregator("median")
