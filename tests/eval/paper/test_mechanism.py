"""A gate's row in the paper follows from its provenance."""

import pytest

from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import paper_numbers, paper_row


@pytest.mark.parametrize(
    ("partition", "k", "config", "row"),
    [
        ("ring", 2, {"source_noise_beta": 1.0}, "testbed/A independent/polar"),
        ("ring", 2, {"source_noise_beta": 0.0}, "testbed/B shared source noise/polar"),
        ("ring", 2, {"token": "window"}, "testbed/kmeans token/polar"),
        ("ring", 4, {"token": "window"}, "testbed/kmeans token/K4"),
        ("ring", 3, {"token": "oracle"}, "testbed/oracle token uniform/K3"),
        ("ring", 4, {"token": "oracle", "token_draw": "marginal"}, "testbed/oracle token learned prior/K4"),
        ("ring", 2, {"latent": "prior", "latent_dim": 16}, "testbed/D continuous zs prior/polar"),
        ("ring", 8, {"latent": "posterior", "kl_weight": 0.01}, "testbed/posterior kl0.01/K8"),
        ("ring", 4, {"latent": "posterior", "kl_weight": 1.0, "free_bits": 0.5}, "testbed/posterior kl1 fb0.5/K4"),
        ("ring", 4, {"latent": "posterior", "kl_weight": 1.0, "free_bits": 0.1}, "testbed/posterior kl1 fb0.1/K4"),
        ("ring", 2, {"source_noise_beta": 0, "consistency_weight": 3}, "testbed/consistency beta0 lambda3/polar"),
        ("ring", 2, {"source_noise_beta": 1, "consistency_weight": 3}, "testbed/consistency beta1 lambda3/K2"),
        ("bypass-v2", 2, {}, "v2/A independent"),
        ("bypass-v2", 2, {"latent": "prior", "latent_dim": 0}, "v2/C zs dim0 anchor"),
        ("bypass-v2", 2, {"source_noise_beta": 0, "consistency_weight": 0.3}, "v2/F consistency beta0 lambda0.3"),
        ("bypass-v2", 2, {"source_noise_beta": 0.1, "consistency_weight": 3}, "v2/consistency beta0.1 lambda3"),
        ("bypass-v2", 2, {"token": "episode", "consistency_weight": 0.1}, "v2/H episode token uniform"),
        ("bypass-v2", 2, {"token": "episode", "token_draw": "learned"}, "v2/I episode token learned prior"),
        ("bypass-v2", 2, {"token": "window", "consistency_weight": 0.1}, "v2/Jp window token k2 lambda0.1"),
        ("bypass-v2", 2, {"token": "window", "n_tokens": 4}, "v2/window token k4"),
        ("rotating-v3", 2, {"token": "oracle"}, "v3/K oracle"),
        ("rotating-v3", 2, {"source_noise_beta": 0, "consistency_weight": 3}, "v3/G consistency lambda3"),
        ("ring", 2, {"source_noise_beta": 0.5}, ""),
        ("someone else's", 2, {}, ""),
    ],
)
def test_a_gate_finds_its_row_in_the_paper(make_gate, partition, k, config, row):
    gate = make_gate(
        "x", k=k, partition=partition, config={"representation": {"kinematic_map": "ring/polar"}, **config}
    )
    assert mechanism_of(gate).paper_row == row
    if row and "posterior" not in row:
        assert paper_row(row), f"the table holds no row {row}"


def test_settings_that_the_paper_did_not_run_have_no_row(make_gate):
    skewed = make_gate("x", dataset={"env_kwargs": {"path_spread": 0.2}})
    assert mechanism_of(skewed).paper_row == ""
    redrawn = make_gate("x", coupling={"share_token": False}, config={"token": "oracle"})
    assert mechanism_of(redrawn).paper_row == ""
    sampled = make_gate("x", coupling={"source_noise_beta": 0.0}, config={"source_noise_beta": 1.0})
    assert mechanism_of(sampled).family == "B shared source noise"
    uniform = make_gate(
        "x",
        partition="bypass-v2",
        coupling={"token_draw": "uniform"},
        config={"token": "episode", "token_draw": "learned"},
    )
    assert mechanism_of(uniform).paper_row == "v2/H episode token uniform"


def test_the_papers_figures_are_package_data():
    assert len(paper_numbers()) > 250
    assert paper_row("v2/A independent")["valid_pair_rate"].value == 0.7729
