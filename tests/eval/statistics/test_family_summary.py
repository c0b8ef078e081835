"""A mechanism is described by its seeds, each counted once."""

import numpy as np
import pytest

from dualhead_eval.statistics.family_summary import find_families, summarise_family
from dualhead_eval.statistics.run import open_runs
from dualhead_eval.statistics.run_summary import summarise_run

NETWORK = {"preconditioning": "none", "conditioning": "concat", "observation_noise": 0.0, "padded_steps": 0}
TRAINING = {"batch_size": 128, "steps": 1000, "fresh_paths": False, "plateaued": True, "judged_loss": "flow_loss"}


@pytest.fixture
def seed_gate(make_gate):
    """The gate of one training seed, with everything that a gate file says of a training."""

    def build(seed, *, label=None, evaluation_seed=0, config=None, training=None, **provenance):
        return make_gate(
            label or f"noise seed {seed}",
            0.6,
            seed=seed,
            config={"source_noise_beta": 0, **NETWORK, **(config or {})},
            training={**TRAINING, "seed": seed, **(training or {})},
            checkpoint=f"weights {seed}",
            **{"training_step": 1000, **provenance, "evaluation": evaluation_seed},
        )

    return build


def test_a_family_is_the_mean_over_its_seeds(make_gate):
    runs = [summarise_run(make_gate(couple=0.3, seed=seed), draws=5) for seed in range(3)]
    family = summarise_family("G", runs)
    assert family.mean["rho"] == pytest.approx(np.mean([run.rho for run in runs]))
    assert family.sd["rho"] == pytest.approx(np.std([run.rho for run in runs], ddof=1))
    deltas, capacities = ([getattr(run, name) for run in runs] for name in ("delta", "capacity"))
    assert family.rho_ratio_of_means == pytest.approx(np.mean(deltas) / np.mean(capacities))
    with pytest.raises(ValueError, match="one operating point"):
        summarise_family("G", [*runs, summarise_run(make_gate(), tau=0.4, draws=5)])


def test_seeds_of_one_mechanism_are_a_family(seed_gate):
    (family,) = find_families(open_runs([seed_gate(seed) for seed in range(4)]))
    assert family.label == "noise"
    assert family.seeds == (0, 1, 2, 3)
    assert family.loss == "4 of 4 settled"
    assert family.mean["rho"] in family.rho_interval
    assert family.equivalence.equivalent is False


@pytest.mark.parametrize(
    "other",
    [
        {"config": {"conditioning": "film"}},
        {"config": {"preconditioning": "gaussian"}},
        {"config": {"observation_noise": 0.05}},
        {"config": {"padded_steps": 15}},
        {"training": {"batch_size": 256}},
        {"training": {"steps": 2000}},
        {"training": {"fresh_paths": True}},
        {"training_step": 500},
    ],
    ids=str,
)
def test_another_network_budget_batch_or_data_is_another_family(seed_gate, other):
    assert find_families(open_runs([seed_gate(0), seed_gate(1, **other)])) == []


def test_a_copied_gate_file_is_no_second_seed(seed_gate):
    with pytest.raises(ValueError, match=r"'noise seed 0' and 'the copy' hold the same checkpoint.*leave one out"):
        find_families(open_runs([seed_gate(0), seed_gate(0, label="the copy")]))


def test_a_second_evaluation_of_a_checkpoint_is_no_second_seed(make_gate):
    """Other draws, other counts, and still one trained policy: it used to be a family of sd 0."""
    again = [
        make_gate(f"run {draws}", 0.6, seed=draws, config={"seed": 7}, training={"seed": 7, **TRAINING})
        for draws in range(2)
    ]
    with pytest.raises(ValueError, match="training seed 7 of one setting"):
        find_families(open_runs(again))


def test_one_checkpoint_under_two_settings_of_the_sampler_is_two_mechanisms(seed_gate):
    private, shared = (
        seed_gate(0, label=str(beta), coupling={"source_noise_beta": beta, "share_token": True}) for beta in (1, 0)
    )
    assert find_families(open_runs([private, shared])) == []


def test_either_head_driving_one_policy_is_a_recording_of_its_own(seed_gate, make_gate):
    policy = seed_gate(0).provenance
    gates = [
        make_gate(control, seed=0, rollouts={"env_kwargs": {"control": control}, "policy": policy})
        for control in ("joint", "position")
    ]
    assert find_families(open_runs(gates)) == []


def test_runs_without_a_known_seed_are_no_seeds(make_gate):
    assert find_families(open_runs([make_gate(f"x {seed}", 0.6, seed=seed) for seed in range(3)])) == []
    with pytest.raises(ValueError, match="the same counts"):
        find_families(open_runs([make_gate("x"), make_gate("y")]))


def test_under_trained_ring_seeds_are_no_family(make_gate):
    under_trained = [make_gate(f"x {i}", 0.6, seed=i, valid=0.5, config={"seed": i}) for i in range(2)]
    assert find_families(open_runs(under_trained)) == []
