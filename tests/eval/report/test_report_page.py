"""Figures, the page, the paper's numbers beside ours, and its claims graded."""

import argparse
import io
import re

import numpy as np
import pytest
from rich.console import Console

from dualhead_eval.commands.report import add_arguments, run
from dualhead_eval.effects.counts import joint_table
from dualhead_eval.gate.gate import Gate, write_gate
from dualhead_eval.paper.claims import grade_claims
from dualhead_eval.paper.comparison import compare_sites, render_sites
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import compare_with_paper, paper_numbers, paper_row
from dualhead_eval.report.content import report_rows
from dualhead_eval.report.figures.figures import CAPTIONS, report_figures
from dualhead_eval.report.figures.forest import forest_figure
from dualhead_eval.report.figures.heatmap import heatmap_figure
from dualhead_eval.report.figures.sensitivity import sensitivity_figure
from dualhead_eval.report.figures.strata import strata_figure
from dualhead_eval.report.tables import render_families
from dualhead_eval.residuals.strata import residual_strata
from dualhead_eval.statistics.family_summary import family_rows
from dualhead_eval.statistics.head_agreement import all_heads_agreement
from dualhead_eval.statistics.run_summary import summarise_run

TAUS, NFES = [0.4, 0.55], [10, 20]


def make_gate(label, couple=0.0, *, k=2, flip=False, heads=2, partition="ring", valid=1.0, seed=0, **provenance):
    rng = np.random.default_rng(seed)
    first = rng.integers(0, k, size=(12, 500))
    labels = [first]
    for _ in range(heads - 1):
        labels.append(np.where(rng.random(first.shape) < couple, (first + flip) % k, rng.integers(0, k, first.shape)))
    strength = rng.random((heads, *first.shape)) ** 0.1
    cut = [
        [
            [
                np.where((s >= t * 0.5) & (rng.random(s.shape) < valid**0.5), m, -1)
                for m, s in zip(labels, strength, strict=True)
            ]
            for t in TAUS
        ]
        for _ in NFES
    ]
    cut = np.array(cut)
    sampled = np.stack([np.stack([joint_table(list(at), k) for at in row]) for row in cut])
    residual = rng.gamma(9, 3, size=first.shape) + 100 * (labels[0] != labels[1])
    return Gate(
        heads=("joint", "position", "rotation")[:heads],
        n_modes=k,
        taus=TAUS,
        nfes=NFES,
        reference_tau=0.55,
        reference_nfe=20,
        counts=sampled,
        conditions=np.zeros((12, 3)),
        pair_ids=np.arange(12),
        provenance={"label": label, "partition": {"name": partition, "n_modes": k}, **provenance},
        strata={"position": residual_strata(np.broadcast_to(residual, cut[:, :, 0].shape), cut[:, :, 0], cut[:, :, 1])},
    )


def ring(name, couple, representation, *, flip=False, beta=0.0, seed=0, method="policy", **more):
    return make_gate(
        name,
        couple,
        flip=flip,
        seed=seed,
        method=method,
        config={"source_noise_beta": beta, "representation": {"kinematic_map": f"ring/{representation}"}, **more},
    )


def test_every_figure_is_drawn_and_captioned():
    gates = [make_gate("a"), make_gate("b", 0.8), make_gate("K=4", 0.9, k=4)]
    figures = report_figures(gates, report_rows(gates))
    assert list(figures) == list(CAPTIONS)
    assert all(png.startswith(b"\x89PNG") for png in figures.values())


def test_gates_that_allow_no_figure_say_so():
    empty = make_gate("none", valid=0.0)
    assert set(report_figures([empty], report_rows([empty]))) == {"heatmap", "strata", "tau", "nfe"}
    with pytest.raises(ValueError, match="defined rho"):
        forest_figure([summarise_run(empty, draws=5)])
    with pytest.raises(ValueError, match="no run"):
        heatmap_figure([])
    with pytest.raises(ValueError, match="strata 'rotation'"):
        strata_figure([empty], "rotation")
    with pytest.raises(ValueError, match="curves"):
        sensitivity_figure([])


def parse(*arguments):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args([str(argument) for argument in arguments])


def test_the_page_is_self_contained_and_escapes_what_it_is_given(tmp_path, capsys):
    gates = [make_gate("<b>bold & co</b>", 0.7), make_gate("three", 0.5, heads=3, valid=0.8)]
    paths = [write_gate(gate, tmp_path / f"{i}.json") for i, gate in enumerate(gates)]
    page, folder = tmp_path / "report.html", tmp_path / "figures"
    assert run(parse(*paths, "--html", page, "--figures", folder, "--paper")) == 0
    text = page.read_text()
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)
    assert "<b>bold" not in text
    assert "&lt;b&gt;bold &amp; co&lt;/b&gt;" in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text)
    assert "not yet readable" in text
    assert {path.stem for path in folder.iterdir()} == {"region", "forest", "heatmap", "strata", "tau", "nfe"}
    assert "claims" in capsys.readouterr().out
    with pytest.raises(FileExistsError, match="--overwrite"):
        run(parse(*paths, "--html", page))


def test_three_way_agreement_of_independent_heads_is_a_quarter():
    """tab:pose: random three-way agreement of two-mode heads is 0.25."""
    independent = all_heads_agreement(make_gate("pose", heads=3, valid=0.8))
    assert independent.chance == pytest.approx(0.25, abs=0.01)
    assert independent.rate in independent.interval
    assert abs(independent.rate - independent.chance) < 0.03
    together = all_heads_agreement(make_gate("pose", 1.0, heads=3))
    assert together.rate == 1
    assert together.valid_rate == 1
    assert np.isnan(all_heads_agreement(make_gate("pose", heads=3, valid=0.0)).rate)


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
def test_a_gate_finds_its_row_in_the_paper(partition, k, config, row):
    gate = make_gate(
        "x", k=k, partition=partition, config={"representation": {"kinematic_map": "ring/polar"}, **config}
    )
    assert mechanism_of(gate).paper_row == row
    if row and "posterior" not in row:
        assert paper_row(row), f"the table holds no row {row}"


def test_settings_that_the_paper_did_not_run_have_no_row():
    skewed = make_gate("x", dataset={"env_kwargs": {"path_spread": 0.2}})
    assert mechanism_of(skewed).paper_row == ""
    redrawn = make_gate("x", coupling={"share_token": False}, config={"token": "oracle"})
    assert mechanism_of(redrawn).paper_row == ""
    sampled = make_gate("x", coupling={"source_noise_beta": 0.0}, config={"source_noise_beta": 1.0})
    assert mechanism_of(sampled).family == "B shared source noise"


def test_our_numbers_stand_beside_the_papers():
    gate = ring("polar noise", 0.67, "polar")
    (rho,) = compare_with_paper([gate], report_rows([gate]))
    assert (rho.quantity, rho.paper, rho.source) == ("rho", 0.678, "tab:maps")
    assert rho.difference == rho.ours - 0.678
    assert rho.ours in rho.interval
    robot = make_gate("A", partition="bypass-v2")
    quantities = {c.quantity: c.paper for c in compare_with_paper([robot], report_rows([robot]))}
    head_valid = {c.quantity: c.head_valid for c in compare_with_paper([robot], report_rows([robot]))}
    exact = make_gate("H", partition="bypass-v2", config={"token": "episode"})
    assert all(c.head_valid is None for c in compare_with_paper([exact], report_rows([exact])))
    assert head_valid["capacity"] == pytest.approx(0.5, abs=0.01)
    assert head_valid["obs"] is None
    assert quantities["valid_rate"] == 0.7729
    assert quantities["residual_mm"] == 84.79
    assert compare_with_paper([make_gate("x", partition="none")], report_rows([make_gate("x", partition="none")])) == []
    assert len(paper_numbers()) > 250


def by_claim(grades):
    return {grade.claim.split()[0] + " " + grade.claim.split()[1]: grade for grade in grades}


def test_claims_without_their_runs_are_not_graded():
    grades = grade_claims([make_gate("a", partition="none")])
    assert len(grades) == 9
    assert [grade.grade for grade in grades] == ["holds"] + ["not graded"] * 8
    assert "0 of 48 tables" in grades[0].evidence


def test_map_dependence_needs_seeds_or_the_population():
    def arms(seeds, method="policy"):
        return [
            ring(f"{name} {rep} {seed}", couple, rep, flip=flip, beta=beta, seed=seed, method=method)
            for seed in range(seeds)
            for rep, strength, flip in (("polar", 0.67, False), ("nullspace", 0.23, True), ("orthogonal", 0.1, True))
            for name, beta, couple in (("A", 1.0, 0.0), ("B", 0.0, strength))
        ]

    key = "The effect"
    assert by_claim(grade_claims(arms(1)))[key].grade == "inconclusive"
    tested = by_claim(grade_claims(arms(6)))[key]
    assert tested.grade == "holds"
    assert "permutation p" in tested.evidence
    assert by_claim(grade_claims(arms(1, method="exact reference")))[key].grade == "holds"
    same_sign = [gate for gate in arms(1) if "polar" not in gate.label]
    assert by_claim(grade_claims(same_sign))[key].grade == "does not hold"


def test_robot_claims_follow_their_criteria():
    def robot(label, couple, **config):
        return make_gate(label, couple, partition="bypass-v2", valid=config.pop("valid", 0.8), config=config)

    independent = robot("A", 0.0)
    latent = robot("D", 0.0, latent="prior", latent_dim=16)
    climb = robot("G", 0.5, source_noise_beta=0, consistency_weight=3, valid=0.5)
    token, weak = robot("K", 1.0, token="oracle"), robot("J", 0.5, token="window")
    grades = by_claim(grade_claims([independent, latent, climb, token]))
    assert grades["Endpoint consistency"].grade == "holds"
    assert grades["Partition tokens"].grade == "holds"
    assert grades["An auxiliary"].grade in ("holds", "inconclusive")
    grades = by_claim(grade_claims([token, weak, robot("D", 0.5, latent="prior", latent_dim=16)]))
    assert grades["Partition tokens"].grade == "inconclusive"
    assert grades["An auxiliary"].grade == "does not hold"
    costless = robot("G", 0.5, source_noise_beta=0, consistency_weight=3, valid=0.9)
    assert by_claim(grade_claims([independent, costless]))["Endpoint consistency"].grade == "inconclusive"


def test_seeds_of_one_mechanism_are_a_family_and_other_settings_are_not():
    seeds = [make_gate(f"noise seed {i}", 0.6, seed=i, config={"source_noise_beta": 0, "seed": i}) for i in range(4)]
    other = make_gate("noise longer", 0.6, seed=9, config={"source_noise_beta": 0, "seed": 0}, training_step=10)
    (family,) = family_rows([*seeds, other], report_rows([*seeds, other]))
    assert family.summary.label == "noise"
    assert [run.label for run in family.summary.runs] == [gate.label for gate in seeds]
    assert family.summary.mean["rho"] in family.rho_interval
    assert family.equivalence.equivalent is False
    console = Console(width=140, record=True, file=io.StringIO())
    console.print(render_families(seeds, report_rows(seeds)))
    assert "the seed is the unit" in console.export_text()
    assert render_families([other], report_rows([other])) is None
    under_trained = [make_gate(f"x {i}", 0.6, seed=i, valid=0.5) for i in range(2)]
    assert family_rows(under_trained, report_rows(under_trained)) == []


def test_numbers_at_another_threshold_are_not_put_beside_the_papers():
    gate = ring("polar noise", 0.67, "polar")
    assert compare_with_paper([gate], report_rows([gate], tau=0.4)) == []


def test_runs_and_the_papers_rows_are_compared_by_their_site():
    oracle = make_gate("oracle", 1.0, partition="bypass-v2", config={"token": "oracle"})
    collapsed = make_gate("independent?", 1.0, partition="bypass-v2")
    v3 = make_gate("v3 oracle", 1.0, partition="rotating-v3", config={"token": "oracle"})
    unknown = make_gate("elsewhere", partition="none")
    gates = [oracle, collapsed, v3, unknown]
    sites = compare_sites(gates, report_rows(gates))
    assert [(c.site, c.paper_site, c.derived) for c in sites] == [
        ("IV", "IV", False),
        ("IV", "I", False),
        ("IV", "IV", True),
    ]
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(render_sites(sites))
    text = console.export_text()
    assert "2 of 3 runs lie at the paper's site" in text
    assert "not independent?: corner IV, where the paper has floor I" in text


def test_a_folder_of_gates_is_reported_beside_the_paper(tmp_path, capsys):
    for label in ("b", "a"):
        write_gate(make_gate(label, partition="bypass-v2"), tmp_path / f"{label}.gate.json")
    assert run(parse(tmp_path)) == 0
    out = capsys.readouterr().out
    assert "v2/A independent" in out
    assert out.index(" a ") < out.index(" b ")
    assert run(parse(tmp_path, "--no-paper")) == 0
    assert "the paper's row" not in capsys.readouterr().out
    assert run(parse(tmp_path, "--every-quantity")) == 0
    assert "capacity" in capsys.readouterr().out
