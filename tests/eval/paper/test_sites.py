"""A run is compared with the site that the paper assigns, and with the spread of the paper's seeds."""

import pytest

from dualhead_eval.paper.seed_spread import seed_spread
from dualhead_eval.paper.sites import compare_sites, criterion_contradiction, paper_site
from dualhead_eval.statistics.run import open_runs


def test_runs_and_the_papers_rows_are_compared_by_their_site(make_gate):
    oracle = make_gate("oracle", 1.0, partition="bypass-v2", config={"token": "oracle"})
    collapsed = make_gate("independent?", 1.0, partition="bypass-v2", seed=1)
    v3 = make_gate("v3 oracle", 1.0, partition="rotating-v3", config={"token": "oracle"})
    sites = compare_sites(open_runs([oracle, collapsed, v3, make_gate("elsewhere", partition="none")]))
    assert [(c.site, c.paper_site, c.agrees) for c in sites] == [
        ("IV", "IV", True),
        ("IV", "I", False),
        ("IV", "IV", True),
    ]


def test_the_text_puts_the_token_families_of_both_robots_in_the_corner():
    """sec:main-tables: "IV, the high-capacity corner (H--K)"; v3's table prints no site."""
    assert [paper_site(f"{env}/H episode token uniform") for env in ("v2", "v3")] == ["IV", "IV"]
    assert "site IV" in criterion_contradiction("v3/H episode token uniform")
    assert criterion_contradiction("v2/H episode token uniform") == ""


def test_a_row_without_a_site_counts_neither_for_nor_against(make_gate):
    config = {"source_noise_beta": 0.0, "representation": {"kinematic_map": "ring/polar"}}
    (site,) = compare_sites(open_runs([make_gate("B", 0.67, config=config)]))
    assert (site.paper_site, site.agrees) == ("?", None)


def test_a_run_is_judged_against_the_spread_of_the_papers_seeds(make_gate):
    """tab:seeds: v2 B has mean -0.54% and sd 3.41 over eight seeds; Student's t on 7 degrees, one more seed."""
    spread = seed_spread("v2/B shared source noise")
    assert (spread.low, spread.high) == pytest.approx((-0.0909, 0.0801), abs=2e-4)
    config = {"source_noise_beta": 0.0}
    near, far = (
        compare_sites(open_runs([make_gate("B", couple, partition="bypass-v2", flip=True, config=config)]))[0]
        for couple in (0.06, 0.3)
    )
    assert (near.agrees, near.within_spread) == (False, True)
    assert (far.agrees, far.within_spread) == (False, False)
    assert seed_spread("v2/K oracle") is None


def test_a_run_just_beside_the_spread_is_inside_if_its_own_interval_reaches_it(make_gate):
    """v3 A: the paper's six seeds lie within +-0.6%, a run of a few conditions is not known that well."""
    spread = seed_spread("v3/A independent")
    gates = [make_gate("A", couple, partition="rotating-v3") for couple in (0.0, 0.1)]
    near, far = (compare_sites(open_runs([gate]))[0] for gate in gates)
    assert near.run.first.rho not in spread
    assert (near.within_spread, far.within_spread) == (True, False)


def test_seeds_printed_one_by_one_give_a_spread_where_there_is_no_expansion():
    spread = seed_spread("v2/E posterior all")
    assert (spread.low, spread.high) == pytest.approx((0.9995, 1.0005))
