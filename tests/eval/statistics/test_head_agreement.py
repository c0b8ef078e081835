"""Agreement of all heads at once."""

import numpy as np
import pytest

from dualhead_eval.statistics.head_agreement import all_heads_agreement


def test_three_way_agreement_of_independent_heads_is_a_quarter(make_gate):
    """tab:pose: random three-way agreement of two-mode heads is 0.25."""
    independent = all_heads_agreement(make_gate("pose", heads=3, valid=0.8))
    assert independent.chance == pytest.approx(0.25, abs=0.01)
    assert independent.rate in independent.interval
    assert abs(independent.rate - independent.chance) < 0.03
    together = all_heads_agreement(make_gate("pose", 1.0, heads=3))
    assert together.rate == 1
    assert together.valid_rate == 1
    assert np.isnan(all_heads_agreement(make_gate("pose", heads=3, valid=0.0)).rate)
