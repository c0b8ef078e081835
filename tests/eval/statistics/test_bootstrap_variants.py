"""Other intervals and tests, against independent implementations and known cases."""

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from scipy import stats

from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.statistics.bootstrap import bootstrap_conditions
from dualhead_eval.statistics.bootstrap_variants import bca_interval, standard_error, studentised_interval
from dualhead_eval.statistics.run_statistics import TERMS, condition_sums
from dualhead_eval.statistics.seeds import (
    benjamini_hochberg,
    interaction_test,
    seed_bootstrap_interval,
    seed_equivalence,
    seed_t_interval,
    smallest_p_value,
)


@pytest.fixture
def sums():
    rng = np.random.default_rng(0)
    couple = rng.random((40, 1)) ** 2
    a, own = rng.integers(0, 2, size=(2, 40, 300))
    b = np.where(rng.random(a.shape) < couple, a, own)
    return condition_sums(joint_counts(np.where(rng.random(a.shape) < 0.2, -1, a), b, 2))


@pytest.mark.parametrize("name", ["rho", "delta", "capacity", "valid_rate", "rho_pooled", "simpson"])
def test_bca_is_scipys(sums, name):
    mine = bca_interval(sums, name, draws=2000, rng=np.random.default_rng(1))

    def statistic(index, axis=-1):
        return sums.statistics(sums.terms[index].sum(axis=-2))[name]

    theirs = stats.bootstrap(
        (np.arange(40),),
        statistic,
        n_resamples=2000,
        method="BCa",
        vectorized=True,
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high), abs=1e-9)


@pytest.mark.parametrize("name", ["rho", "delta", "obs", "valid_rate"])
def test_the_linearised_error_is_the_bootstraps(sums, name):
    replicates = bootstrap_conditions(sums, draws=4000).values[name]
    assert standard_error(sums, name) == pytest.approx(replicates.std(), rel=0.1)


def test_the_studentised_interval_leans_where_the_skew_is(sums):
    percentile = bootstrap_conditions(sums).interval("rho", 0.95)
    studentised = studentised_interval(sums, "rho")
    estimate = sums.statistics(sums.total())["rho"]
    assert studentised.low < estimate < studentised.high
    assert studentised.high - studentised.low == pytest.approx(percentile.high - percentile.low, rel=0.3)
    with pytest.raises(KeyError, match="bca_interval"):
        studentised_interval(sums, "rho_pooled")
    with pytest.raises(KeyError, match="bca_interval"):
        studentised_interval(replace(sums, estimator="unbiased"), "rho")


def test_clusters_of_conditions_widen_the_interval(sums):
    groups = np.argsort(np.argsort(sums.terms[:, TERMS.index("delta")])) // 4
    by_condition = bootstrap_conditions(sums).interval("delta", 0.95)
    by_cluster = bootstrap_conditions(sums.grouped(groups)).interval("delta", 0.95)
    assert sums.grouped(groups).total() == pytest.approx(sums.total())
    assert by_cluster.high - by_cluster.low > 1.5 * (by_condition.high - by_condition.low)
    with pytest.raises(ValueError, match="one per condition"):
        sums.grouped(groups[:-1])


def test_intervals_without_spread_or_capacity_are_undefined():
    table = np.zeros((10, 3, 3), dtype=int)
    table[:, 0, 0] = 5
    for interval in (
        bca_interval(condition_sums(table), "rho"),
        studentised_interval(condition_sums(table), "rho"),
    ):
        assert np.isnan(interval.low)
    table[:, 1, 1] = 5
    assert np.isnan(bca_interval(condition_sums(table), "rho").low)


def test_seed_intervals_are_students():
    x = [0.617, 0.388, 0.495, 0.5, 0.41]
    mine, theirs = seed_t_interval(x), stats.ttest_1samp(x, 0).confidence_interval(0.95)
    assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high))
    boot = seed_bootstrap_interval(x, rng=np.random.default_rng(0))
    assert mine.low < boot.low < boot.high < mine.high
    with pytest.raises(ValueError, match="at least 2"):
        seed_t_interval([0.5])
    with pytest.raises(ValueError, match="named, not averaged"):
        seed_t_interval([0.5, np.nan])


def test_the_papers_floor_passes_at_seed_level_and_shared_noise_does_not():
    """tab:seeds: six seeds with mean 0.27% and sd 0.27 pp; eight with -0.54% and 3.41 pp."""
    shape = np.array([-1.2, -0.7, -0.1, 0.1, 0.7, 1.2])
    floor = 0.0027 + 0.0027 * shape / shape.std(ddof=1)
    noise = np.tile([-1.0, 1.0], 4)
    noise = -0.0054 + 0.0341 * noise / noise.std(ddof=1)
    assert seed_equivalence(floor).equivalent is True
    assert seed_equivalence(noise).equivalent is False


def test_the_interaction_test_sees_a_map_that_reverses_the_effect():
    rng = np.random.default_rng(0)
    reversed_ = np.array([[0.668], [-0.233], [-0.093]]) + 0.015 * rng.normal(size=(3, 10))
    result = interaction_test(reversed_, rng=rng)
    assert result.p_value == pytest.approx(1e-4, rel=0.01)
    assert result.spread == pytest.approx(0.901, abs=0.02)
    with pytest.raises(ValueError, match="levels"):
        interaction_test([[0.1, 0.2]], rng=rng)


@pytest.mark.parametrize(("levels", "seeds"), [(2, 3), (2, 5), (3, 2), (3, 3), (4, 2)])
def test_the_smallest_p_value_is_that_of_seeds_in_one_order(levels, seeds):
    """Every relabelling, counted: no effects give a smaller share than those with one order in every seed."""
    ordered = np.arange(levels)[:, None] ** 2 + np.zeros(seeds)
    orders = list(permutations(range(levels)))
    spreads = [np.ptp(sum(np.array(o) ** 2 for o in choice)) for choice in product(orders, repeat=seeds)]
    share = np.mean(np.isclose(spreads, np.ptp(ordered.sum(axis=1))))
    assert smallest_p_value(levels, seeds) == pytest.approx(share)
    test = interaction_test(ordered, permutations=4000, rng=np.random.default_rng(0))
    assert test.smallest_p_value == pytest.approx(share, rel=0.01)
    assert test.p_value == pytest.approx(share, rel=0.35, abs=0.01)


@pytest.mark.parametrize("blocked", [True, False])
def test_without_an_interaction_its_p_values_are_uniform(blocked):
    rng = np.random.default_rng(1)
    p = [
        interaction_test(rng.normal(size=(3, 5)), permutations=199, rng=rng, blocked=blocked).p_value
        for _ in range(400)
    ]
    assert stats.kstest(p, "uniform").pvalue > 0.001


def test_benjamini_hochberg_by_hand():
    np.testing.assert_allclose(benjamini_hochberg([0.01, 0.04, 0.03, 0.005]), [0.02, 0.04, 0.04, 0.02])
    with pytest.raises(ValueError, match="outside"):
        benjamini_hochberg([0.1, 1.1])
