"""Differences of mechanisms: over seeds where there are some, over conditions otherwise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ttest_ind

from dualhead_eval.statistics.difference import difference, welch_interval
from dualhead_eval.statistics.run import open_run

SAMPLES = st.lists(st.floats(-1, 1).map(lambda x: round(x, 6)), min_size=2, max_size=6).filter(
    lambda values: np.std(values) > 1e-6
)


@given(SAMPLES, SAMPLES)
def test_welchs_interval_is_scipys(first, second):
    mine = welch_interval(np.array(first), np.array(second))
    theirs = ttest_ind(first, second, equal_var=False).confidence_interval(0.95)
    assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high))


def test_equal_seeds_differ_by_a_point():
    interval = welch_interval(np.array([0.5, 0.5]), np.array([0.25, 0.25]))
    assert (interval.low, interval.high) == (0.25, 0.25)


def test_one_checkpoint_a_side_is_compared_under_the_same_conditions(make_gate):
    strong, weak = open_run(make_gate("G", 0.5, seed=1)), open_run(make_gate("B", 0.1, seed=2))
    gap = difference([strong], [weak], "rho")
    assert gap.unit == "conditions"
    assert gap.value == strong.first.rho - weak.first.rho
    assert gap.interval.low < gap.value < gap.interval.high
    nothing = difference([strong], [strong], "rho")
    assert (nothing.interval.low, nothing.interval.high) == (0, 0)


def test_two_seeds_a_side_are_compared_over_seeds(make_gate):
    strong, weak = ([open_run(make_gate(couple=c, seed=seed)) for seed in range(2)] for c in (0.5, 0.1))
    assert difference(strong, weak, "valid_rate").unit == "seeds"
