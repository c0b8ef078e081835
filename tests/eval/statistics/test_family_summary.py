"""A mechanism is described by its seeds, each counted once."""

import numpy as np
import pytest

from dualhead_eval.statistics.family_summary import find_families, summarise_family
from dualhead_eval.statistics.run import open_runs
from dualhead_eval.statistics.run_summary import summarise_run


def test_a_family_is_the_mean_over_its_seeds(make_gate):
    runs = [summarise_run(make_gate(couple=0.3, seed=seed), draws=5) for seed in range(3)]
    family = summarise_family("G", runs)
    assert family.mean["rho"] == pytest.approx(np.mean([run.rho for run in runs]))
    assert family.sd["rho"] == pytest.approx(np.std([run.rho for run in runs], ddof=1))
    deltas, capacities = ([getattr(run, name) for run in runs] for name in ("delta", "capacity"))
    assert family.rho_ratio_of_means == pytest.approx(np.mean(deltas) / np.mean(capacities))
    with pytest.raises(ValueError, match="one operating point"):
        summarise_family("G", [*runs, summarise_run(make_gate(), tau=0.4, draws=5)])


def test_seeds_of_one_mechanism_are_a_family_and_other_settings_are_not(make_gate):
    seeds = [make_gate(f"noise seed {i}", 0.6, seed=i, config={"source_noise_beta": 0, "seed": i}) for i in range(4)]
    other = make_gate("noise longer", 0.6, seed=9, config={"source_noise_beta": 0, "seed": 0}, training_step=10)
    (family,) = find_families(open_runs([*seeds, other]))
    assert family.label == "noise"
    assert [run.label for run in family.runs] == [gate.label for gate in seeds]
    assert family.mean["rho"] in family.rho_interval
    assert family.equivalence.equivalent is False
    assert find_families(open_runs([other])) == []


def test_under_trained_seeds_are_no_family(make_gate):
    assert find_families(open_runs([make_gate(f"x {i}", 0.6, seed=i, valid=0.5) for i in range(2)])) == []
