"""Conditions first, then weighted means, then their ratio: against loops that do just that."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.statistics.bootstrap import bootstrap_conditions, equivalence_test, resample_weights
from dualhead_eval.statistics.run_statistics import condition_sums
from dualhead_eval.statistics.run_summary import summarise_table, total_variation


def sampled_table(seed=0, conditions=20, pairs=200, k=2, couple=0.4, invalid=0.2):
    rng = np.random.default_rng(seed)
    prior = rng.dirichlet(np.full(k, 3.0), size=conditions)
    draw = lambda: (prior[:, None, :].cumsum(-1) < rng.random((conditions, pairs, 1))).sum(-1)  # noqa: E731
    a = draw()
    b = np.where(rng.random(a.shape) < couple, a, draw())
    a, b = (np.where(rng.random(a.shape) < invalid, -1, x) for x in (a, b))
    return joint_counts(a, b, k)


def naive_run(tables):
    """The aggregation order, one condition at a time."""
    weight = obs = bl = delta = capacity = tight = 0.0
    for table in tables:
        effect = coordination(table[:-1, :-1])
        if effect.n == 0:
            continue
        weight += effect.n
        obs += effect.n * effect.obs
        bl += effect.n * effect.bl
        delta += effect.n * effect.delta
        capacity += effect.n * effect.capacity
        tight += effect.n * effect.capacity_tight
    return {
        "valid_rate": weight / tables.sum(),
        "obs": obs / weight,
        "bl": bl / weight,
        "delta": delta / weight,
        "capacity": capacity / weight,
        "capacity_tight": tight / weight,
        "rho": delta / capacity if capacity > 0 else np.nan,
    }


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4), st.floats(0, 1), st.floats(0, 0.9))
def test_a_run_is_the_weighted_mean_of_its_conditions(seed, k, couple, invalid):
    table = sampled_table(seed, conditions=6, pairs=30, k=k, couple=couple, invalid=invalid)
    if table[:, :-1, :-1].sum() == 0:
        return
    summary = summarise_table(table, estimator="plug-in", draws=5)
    for name, value in naive_run(table).items():
        assert getattr(summary, name) == pytest.approx(value, abs=1e-12, nan_ok=True)
    pooled = coordination(table[:, :-1, :-1].sum(axis=0))
    assert summary.delta_pooled == pytest.approx(pooled.delta, abs=1e-12)
    assert summary.rho_pooled == pytest.approx(pooled.rho, abs=1e-12, nan_ok=True)


def test_the_simpson_term_is_the_comovement_of_the_marginals():
    """rmk:simpson with both-valid weights: pooled minus within is sum_k Cov_c(q_k, p_k)."""
    table = sampled_table(3, conditions=40)
    effect = coordination(table[:, :-1, :-1])
    weight = effect.n / effect.n.sum()
    covariance = (weight[:, None] * effect.q * effect.p).sum() - ((weight @ effect.q) * (weight @ effect.p)).sum()
    assert summarise_table(table, draws=5).simpson == pytest.approx(covariance, abs=1e-12)


def test_pooling_books_condition_level_changes_as_coordination():
    left, right = np.outer([90, 10], [90, 10]), np.outer([10, 90], [10, 90])
    table = np.pad(np.stack([left, right]), ((0, 0), (0, 1), (0, 1)))
    summary = summarise_table(table, draws=5)
    assert summary.delta == 0
    assert summary.delta_pooled == pytest.approx(0.32)
    assert summary.simpson == summary.delta_pooled


def test_bootstrap_replicates_re_run_the_whole_order():
    table = sampled_table(1, conditions=15, pairs=60, invalid=0.5)
    replicates = bootstrap_conditions(condition_sums(table), draws=50, rng=np.random.default_rng(7))
    chosen = np.random.default_rng(7).integers(0, 15, size=(50, 15))
    for draw, conditions in enumerate(chosen):
        for name, value in naive_run(table[conditions]).items():
            assert replicates.values[name][draw] == pytest.approx(value, abs=1e-12)
        pooled = coordination(table[conditions][:, :-1, :-1].sum(axis=0))
        assert replicates.values["delta_pooled"][draw] == pytest.approx(pooled.delta, abs=1e-12)


def test_weights_count_how_often_each_condition_was_drawn():
    weights = resample_weights(9, 100, np.random.default_rng(0))
    chosen = np.random.default_rng(0).integers(0, 9, size=(100, 9))
    np.testing.assert_array_equal(weights, [np.bincount(row, minlength=9) for row in chosen])


def test_the_frozen_bootstrap_is_reproducible():
    sums = condition_sums(sampled_table())
    first, second = (bootstrap_conditions(sums).interval("rho", 0.95) for _ in range(2))
    assert first == second


def test_independent_heads_pass_the_equivalence_test_and_coupled_heads_do_not():
    independent = bootstrap_conditions(condition_sums(sampled_table(5, conditions=75, pairs=1280, couple=0)))
    coupled = bootstrap_conditions(condition_sums(sampled_table(5, conditions=75, pairs=1280, couple=0.1)))
    assert equivalence_test(independent).equivalent is True
    assert equivalence_test(coupled).equivalent is False
    assert equivalence_test(coupled, margin=0.2).equivalent is True
    test = equivalence_test(independent)
    assert test.width == max(abs(test.interval.low), abs(test.interval.high))
    with pytest.raises(ValueError, match="margin"):
        equivalence_test(independent, margin=0)


def test_replicates_without_capacity_are_counted_and_undo_the_interval():
    table = np.zeros((10, 3, 3), dtype=int)
    table[:, 0, 0] = 100
    table[0, :2, :2] = [[40, 10], [10, 40]]
    summary = summarise_table(table)
    interval = summary.intervals["rho"]
    missing = (1 - 1 / 10) ** 10
    assert interval.undefined == pytest.approx(2000 * missing, rel=0.15)
    assert np.isnan(interval.low)
    assert summary.equivalence.equivalent is None
    assert summary.equivalence.verdict == "undefined"
    assert np.isfinite(summary.rho)


def test_collapse_is_named_and_never_becomes_perfect_coordination():
    table = np.zeros((4, 3, 3), dtype=int)
    table[:, 1, 1] = 50
    summary = summarise_table(table)
    assert summary.delta == summary.capacity == 0
    assert np.isnan(summary.rho)
    assert "single mode" in summary.reason
    assert summary.occupancy is Occupancy.ORIGIN


def test_without_a_valid_pair_only_the_valid_rate_is_defined():
    table = np.zeros((4, 3, 3), dtype=int)
    table[:, 2, 0] = 50
    summary = summarise_table(table)
    assert summary.valid_rate == 0
    assert np.isnan([summary.delta, summary.capacity, summary.rho, summary.entropy_q]).all()
    assert summary.occupancy is Occupancy.UNKNOWN
    assert "valid-pair rate" in summary.reason


def test_the_validity_weighted_outcome_counts_every_sampled_pair():
    table = np.array([[[30, 10, 5], [5, 30, 5], [5, 5, 5]]])
    summary = summarise_table(table, draws=5)
    assert summary.valid_rate == 0.75
    assert summary.agreement_all == 0.6
    assert summary.effect_all == pytest.approx(0.75 * summary.delta)


def test_fidelity_compares_with_the_data_and_not_the_other_head():
    table = np.array([[[80, 0, 0], [0, 20, 0], [0, 0, 0]]])
    summary = summarise_table(table, target=[0.5, 0.5], draws=5)
    assert summary.tv_target_q == summary.tv_target_p == pytest.approx(0.3)
    assert np.isnan(summarise_table(table, draws=5).tv_target_q)
    assert total_variation([1, 0], [0, 1]) == 1


@pytest.mark.parametrize("shape", [(3, 3), (0, 3, 3), (4, 2, 2), (4, 3, 4)])
def test_tables_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match="expected"):
        summarise_table(np.ones(shape, dtype=int))


def test_p_values_follow_the_intervals():
    independent = summarise_table(sampled_table(5, conditions=75, pairs=640, couple=0))
    coupled = summarise_table(sampled_table(5, conditions=75, pairs=640, couple=0.1))
    assert (independent.p_value > 0.05) == (0 in independent.intervals["rho"])
    assert coupled.p_value == pytest.approx(2 / 2001)
    assert np.isnan(summarise_table(np.pad(np.full((4, 1, 1), 9), ((0, 0), (0, 2), (0, 2)))).p_value)


def few_pairs(conditions=20_000, n=2, seed=0):
    """Two pairs a condition: marginals and coupling vary from one condition to the next."""
    rng = np.random.default_rng(seed)
    left, couple = rng.beta(2, 2, size=(conditions, 1)), rng.random((conditions, 1))
    a, own = (rng.random((conditions, n)) < left for _ in range(2))
    b = np.where(rng.random((conditions, n)) < couple, a, own)
    truth = (couple * 2 * left * (1 - left)).mean(), (2 * left * (1 - left)).mean()
    return joint_counts(a.astype(int), b.astype(int), 2), truth


def test_two_pairs_a_condition_are_enough_without_the_plug_in_bias():
    table, (delta, capacity) = few_pairs()
    plug_in = summarise_table(table, estimator="plug-in", draws=50)
    unbiased = summarise_table(table, draws=500)
    assert unbiased.estimator == "unbiased"
    assert plug_in.delta == pytest.approx(delta / 2, rel=0.05)
    assert unbiased.delta in unbiased.intervals["delta"]
    assert delta in unbiased.intervals["delta"]
    assert capacity in unbiased.intervals["capacity"]
    assert unbiased.rho == pytest.approx(delta / capacity, rel=0.05)
    assert unbiased.bl == pytest.approx(unbiased.obs + unbiased.delta)
    assert np.isnan(unbiased.capacity_tight)


def rare_mode(conditions, n, rare=0.01, rho=0.5, seed=0):
    """Both heads choose the rare mode alike often, with coordination rho."""
    both = rare**2 + rho * rare * (1 - rare)
    cells = [1 - 2 * rare + both, rare - both, rare - both, both]
    table = np.zeros((conditions, 3, 3), dtype=int)
    table[:, :2, :2] = np.random.default_rng(seed).multinomial(n, cells, size=conditions).reshape(-1, 2, 2)
    return table


def test_where_a_mode_is_rare_more_pairs_are_few():
    """Of 64 pairs a rare mode gets fewer than one: the plug-in capacity is then mostly zero, and rho too large."""
    table = rare_mode(4000, 64)
    assert summarise_table(table, estimator="plug-in", draws=5).rho > 0.65
    summary = summarise_table(table, draws=5)
    assert summary.estimator == "unbiased"
    assert summary.rho == pytest.approx(0.5, abs=0.04)
    assert summarise_table(rare_mode(40, 1280, rare=0.005), draws=5).estimator == "plug-in"


def test_one_head_collapsed_in_every_condition_leaves_no_capacity_at_few_pairs():
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 2, size=(2, 4000, 8))
    a[::2], b[1::2] = 0, 0
    assert summarise_table(joint_counts(a, b, 2), draws=5).capacity < 0.03


def test_many_pairs_make_the_estimators_one():
    table = sampled_table(2, conditions=30, pairs=2000)
    plug_in, unbiased = (summarise_table(table, estimator=name, draws=50) for name in ("plug-in", "unbiased"))
    assert summarise_table(table, draws=5).estimator == "plug-in"
    assert plug_in.delta == pytest.approx(unbiased.delta, rel=2e-3)
    with pytest.raises(ValueError, match="estimator"):
        summarise_table(table, estimator="exact")


def test_single_pairs_leave_only_the_pooled_effect():
    table, _ = few_pairs(conditions=200, n=1)
    summary = summarise_table(table, draws=20)
    assert np.isnan([summary.delta, summary.rho]).all()
    assert summary.delta_pooled > 0
    assert "only the pooled effect" in summary.reason
    assert summary.occupancy is Occupancy.UNKNOWN


def test_decisions_of_one_episode_are_resampled_together():
    table, _ = few_pairs(conditions=400, n=4)
    table = np.repeat(table[:40], 10, axis=0)
    alone, together = (summarise_table(table, clusters=clusters) for clusters in (None, np.repeat(np.arange(40), 10)))
    assert (alone.n_clusters, together.n_clusters) == (400, 40)
    wide, narrow = (s.intervals["delta"].high - s.intervals["delta"].low for s in (together, alone))
    assert wide > 2 * narrow
