"""Figures of sweeps: which runs share a line, and what is drawn beside them."""

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.report.content import make_report
from dualhead_eval.report.figures.figures import CAPTIONS, report_figures
from dualhead_eval.report.figures.ladder import ladder_figure, ladder_lines
from dualhead_eval.report.figures.maps import MAPS, map_figure, map_lines
from dualhead_eval.report.figures.mode_counts import mode_count_figure, mode_count_lines
from dualhead_eval.report.figures.overlay import environments, overlay_figure
from dualhead_eval.report.figures.skew import skew_figure, skew_lines
from dualhead_eval.statistics.run import open_run


@pytest.fixture(scope="module")
def ring(make_gate):
    """A trained run on the ring, by its settings."""

    def run(couple=0.3, *, seed=0, k=2, ring_map="nullspace", steps=6000, **config):
        gate = make_gate(
            f"{ring_map} {config} {seed}",
            couple,
            seed=seed,
            k=k,
            pairs=60,
            conditions=6,
            prior=config.pop("prior", None),
            config={"seed": seed, "kinematic_map": f"ring/{ring_map}", "conditioning": "film", **config},
            training_step=steps,
        )
        return open_run(gate)

    return run


@pytest.fixture(scope="module")
def exact(make_gate):
    """An exact reference on the ring."""

    def run(couple, *, ring_map="nullspace", beta=0.0, weight=0.0):
        return open_run(
            make_gate(
                "exact", couple, pairs=60, conditions=6, method="exact reference", kinematic_map=f"ring/{ring_map}",
                source_noise_beta=beta, consistency_weight=weight,
            )
        )  # fmt: skip

    return run


def ladder(ring, **more):
    return [
        ring(0.1 + 0.1 * n, seed=seed, source_noise_beta=0.0, consistency_weight=w, **more)
        for n, w in enumerate((0.0, 0.3, 3.0))
        for seed in (0, 1)
    ]


def test_a_ladder_is_a_line_of_seeds_with_the_papers_points_and_the_optimum_of_its_own(ring, exact):
    runs = [*ladder(ring), *(exact(0.1 * n, weight=w) for n, w in enumerate((0.0, 0.3, 3.0)))]
    trained, optimum = ladder_lines(runs)
    assert (trained.name, trained.reference) == ("ring nullspace, beta 0, default network, 6,000 steps", False)
    assert (optimum.name, optimum.reference) == ("ring nullspace, beta 0, exact", True)
    assert trained.what == optimum.what, "one colour"
    assert trained.settings == optimum.settings == [0.0, 0.3, 3.0]
    assert [len(trained.runs[setting]) for setting in trained.settings] == [2, 2, 2]
    assert trained.means("rho") == pytest.approx(
        [np.mean([run.first.rho for run in trained.runs[setting]]) for setting in trained.settings]
    )
    assert trained.paper == {0.0: -0.227, 3.0: -0.073}
    figure = ladder_figure([trained, optimum])
    assert len(figure.axes) == 3


def test_runs_that_differ_in_more_than_the_weight_share_no_line(ring):
    assert not ladder_lines(
        [
            ring(source_noise_beta=0.0),
            ring(source_noise_beta=0.0, consistency_weight=1.0, steps=9000),
            ring(source_noise_beta=1.0, consistency_weight=2.0),
            ring(source_noise_beta=0.0, consistency_weight=3.0, ring_map="polar"),
            ring(source_noise_beta=0.0, consistency_weight=4.0, token="oracle"),
        ]
    )
    with pytest.raises(ValueError, match="3 or more weights"):
        ladder_figure([])


def test_mechanisms_are_followed_over_the_number_of_modes(ring):
    runs = [ring(0.9, k=k, token="oracle") for k in (2, 3, 4)] + [ring(0.0, k=2)]
    (line,) = mode_count_lines(runs)
    assert line.name.startswith("nullspace, oracle token, uniform draw")
    assert line.settings == [2, 3, 4]
    assert set(line.paper) == {2, 3, 4}
    assert mode_count_figure([line]).axes[0].get_xscale() == "log"
    with pytest.raises(ValueError, match="two numbers of modes"):
        mode_count_figure([])


def test_maps_stand_side_by_side_with_the_exact_optimum(ring, exact):
    runs = [ring(0.3, ring_map=name, source_noise_beta=0.0, seed=s) for name in MAPS for s in (0, 1)]
    runs += [exact(0.3, ring_map=name) for name in MAPS]
    trained, optimum = map_lines(runs)
    assert trained.what == optimum.what == "shared noise"
    assert optimum.reference
    assert trained.paper == pytest.approx({0: -0.227, 1: -0.092, 2: 0.678})
    figure = map_figure([trained, optimum])
    assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == list(MAPS)
    with pytest.raises(ValueError, match="two maps"):
        map_figure([])


def test_a_skewed_prior_stands_beside_the_targets_own_capacity(make_gate):
    runs = []
    for p in (0.5, 0.8, 0.92):
        gate = make_gate(
            "skew", 0.6, prior=[p, 1 - p], pairs=60, conditions=6,
            config={"kinematic_map": "ring/nullspace", "token": "window"},
        )  # fmt: skip
        runs.append(open_run(replace(gate, target_probabilities=np.array([p, 1 - p]))))
    (line,) = skew_lines(runs)
    assert line.settings == [0.5, 0.8, 0.92]
    figure = skew_figure([line])
    target = next(drawn for drawn in figure.axes[0].lines if drawn.get_label() == "the target's own capacity")
    # At the even prior both may reach the most that two modes allow, at p it is 4 p (1 - p) of it.
    assert target.get_ydata()[0] == 1
    assert target.get_ydata()[-1] == pytest.approx(4 * 0.92 * 0.08)
    with pytest.raises(ValueError, match="two priors"):
        skew_figure([])


def test_the_overlay_names_every_environment_and_number_of_modes(make_gate):
    report = make_report(
        [make_gate("a", 0.2), make_gate("b", 0.9, k=3, partition="bypass-v2-three-ways"), make_gate("n", valid=0.0)]
    )
    assert environments(report) == ["ring", "bypass-v2-three-ways"]
    figure = overlay_figure(report)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ring, K = 2", "v2, three ways, K = 3"]
    drawn = np.concatenate([points.get_offsets() for points in figure.axes[0].collections])
    assert np.allclose(drawn[1], [run.first.capacity / (2 / 3) for run in report.runs[1:2]] + [drawn[1][1]])
    with pytest.raises(ValueError, match="no run has a both-valid pair"):
        overlay_figure(make_report([make_gate("n", valid=0.0)]))


def test_a_report_draws_the_sweeps_that_its_runs_make(ring, make_gate):
    gates = [run.gate for run in ladder(ring)] + [make_gate("v2", 0.3, partition="bypass-v2")]
    figures = report_figures(make_report(gates))
    assert {"ladder", "overlay"} <= set(figures)
    assert not {"modes", "maps", "skew"} & set(figures)
    assert [name for name in CAPTIONS if name in figures] == list(figures)
