"""Merging gates, as if everything had been evaluated together."""

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.gate.merge import merge_gates
from dualhead_eval.statistics.run_summary import summarise_run


def test_merging_conditions_equals_evaluating_them_together(make_gate):
    one, two = make_gate(conditions=5), make_gate(seed=1, conditions=3)
    two = replace(two, pair_ids=5 + two.pair_ids)
    merged = merge_gates([one, two])
    np.testing.assert_array_equal(merged.counts, np.concatenate([one.counts, two.counts], axis=2))
    assert merged.n_conditions == 8
    np.testing.assert_array_equal(
        merged.strata["position"].u, np.concatenate([one.strata["position"].u, two.strata["position"].u], 2)
    )
    summary = summarise_run(merged, draws=10)
    assert summary.n_pairs == summarise_run(one, draws=10).n_pairs + summarise_run(two, draws=10).n_pairs


def test_merging_samples_of_the_same_conditions_adds_their_counts(make_gate):
    one, two = make_gate(), make_gate(seed=1)
    merged = merge_gates([one, two])
    np.testing.assert_array_equal(merged.counts, one.counts + two.counts)
    assert merged.n_conditions == one.n_conditions
    assert merged.strata == {}
    assert len(merged.provenance["merged_from"]) == 2


def test_gates_that_do_not_belong_together_are_refused(make_gate):
    gate = make_gate()
    other_partition = replace(gate, provenance=gate.provenance | {"partition": {"name": "bypass-v2", "n_modes": 2}})
    with pytest.raises(ValueError, match="partition"):
        merge_gates([gate, other_partition])
    with pytest.raises(ValueError, match="label"):
        merge_gates([gate, make_gate("another run")])
    with pytest.raises(ValueError, match="given twice"):
        merge_gates([gate, make_gate()])
    with pytest.raises(ValueError, match="target_probabilities"):
        merge_gates([gate, replace(make_gate(seed=1), target_probabilities=np.array([0.5, 0.5]))])
    with pytest.raises(ValueError, match="no gate"):
        merge_gates([])
