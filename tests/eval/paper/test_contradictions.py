"""Printed numbers that cannot be true together are found by the functions that compute ours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualhead_eval.paper.contradictions import contradictions, smallest_sd
from dualhead_eval.paper.numbers import paper_numbers


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("v2/H episode token uniform", "rho +91.1% beside delta / C = +0.4481 / 0.4885 = +91.7%"),
        ("v2/I episode token learned prior", "rho +97.9% beside delta / C = +0.4876 / 0.4907 = +99.4%"),
        ("v2/H episode token uniform", "BL 0.4772 in tab:main, 0.4913 in tab:percond-v2"),
        ("v2/A independent", "rho +0.1% beside delta / C = -0.0006 / 0.4439 = -0.1%"),
        ("v3/A independent", "rho 0 in tab:v3, 0.003 in tab:percond-v3"),
        ("v3/G consistency lambda3", "6 seeds that hold +65.0%, +56.8%, +67.9%"),
        ("v3/H episode token uniform", "printed 3.26"),
        ("v3/H episode token uniform", "robot-side tokens reach 91.1% to 100%, this row +84.1%"),
        ("v3/K oracle", "|delta| 0.4994 exceeds C 0.4964"),
        ("testbed skew/posterior kl0.01/p0.92", "allow C_rel at most 0.0050, printed 0.006"),
        ("testbed skew/posterior kl0.01/p0.92", "allow entropy_rel at most 0.0139, printed 0.017"),
    ],
)
def test_what_the_paper_contradicts_is_found(row, words):
    assert any(words in text for text in contradictions(row))


@pytest.mark.parametrize(
    "row", ["v2/B shared source noise", "v2/G consistency beta0 lambda3", "v2/K oracle", "", "elsewhere"]
)
def test_rows_that_agree_up_to_rounding_are_left_alone(row):
    assert contradictions(row) == ()


def test_no_other_row_of_the_main_tables_contradicts_itself():
    rows = {p.row for p in paper_numbers() if p.source in ("tab:main", "tab:v3") and "/seed" not in p.row}
    assert {row for row in rows if contradictions(row)} == {
        "v2/A independent",
        "v2/H episode token uniform",
        "v2/I episode token learned prior",
        "v2/J window token k2 uniform",
        "v2/window token k4",
        "v3/A independent",
        "v3/G consistency lambda3",
        "v3/H episode token uniform",
        "v3/K oracle",
    }


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=8), st.integers(1, 8))
def test_no_set_of_values_has_a_smaller_sd_than_the_bound(values, known):
    data = np.array(values)
    bound = smallest_sd(values[: min(known, len(values))], (data.mean(), data.mean()), len(values))
    assert bound <= data.std(ddof=1) + 1e-9
