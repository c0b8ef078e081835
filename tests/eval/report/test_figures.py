"""Every figure reads from the report."""

import io
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.text import Text

from dualhead_eval.report.content import make_report
from dualhead_eval.report.figures.figures import CAPTIONS, report_figures
from dualhead_eval.report.figures.forest import forest_figure
from dualhead_eval.report.figures.heatmap import heatmap_figure
from dualhead_eval.report.figures.label_placement import spaced
from dualhead_eval.report.figures.region import draw_region, region_figure
from dualhead_eval.report.figures.sensitivity import sensitivity_figure
from dualhead_eval.report.figures.strata import strata_figure


def texts(figure):
    """Everything that is written in a figure."""
    return {text.get_text() for ax in figure.axes for text in [*ax.texts, *ax.get_yticklabels(), ax.title]}


def test_every_figure_is_drawn_and_captioned(make_gate):
    figures = report_figures(make_report([make_gate("a"), make_gate("b", 0.8), make_gate("K=4", 0.9, k=4)]))
    sweeps = {"ladder", "modes", "maps", "skew", "overlay"}
    assert list(figures) == [name for name in CAPTIONS if name not in sweeps]
    assert all(png.startswith(b"\x89PNG") for png in figures.values())


def test_gates_that_allow_no_figure_say_so(make_gate):
    empty = make_report([make_gate("none", valid=0.0)])
    assert set(report_figures(empty)) == {"heatmap", "strata", "tau", "nfe"}
    with pytest.raises(ValueError, match="defined rho"):
        forest_figure(empty)
    with pytest.raises(ValueError, match="no run"):
        heatmap_figure(make_report([]))
    with pytest.raises(ValueError, match="strata 'rotation'"):
        strata_figure(empty, "rotation")
    with pytest.raises(ValueError, match="curves"):
        sensitivity_figure([])


def test_the_region_is_drawn_as_png(make_gate, tmp_path):
    report = make_report([make_gate("a", 0.2), make_gate("b", 0.9, k=4)])
    path = draw_region(report, tmp_path / "deep" / "region.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(ValueError, match="no run has a both-valid pair"):
        draw_region(make_report([make_gate("none", valid=0.0)]), tmp_path / "empty.png")
    assert not (tmp_path / "empty.png").exists()


def test_the_strata_are_those_of_the_reports_operating_point(make_gate):
    gate = make_gate(weak=True, partition="bypass-v2")
    shares = [make_report([gate], tau=tau).runs[0].residuals["position"].cross_share for tau in (0.4, 0.55)]
    assert shares[0] != shares[1]
    for tau, share in zip((0.4, 0.55), shares, strict=True):
        assert any(f"{share:.1%}" in text for text in texts(strata_figure(make_report([gate], tau=tau))))


def test_a_three_head_run_keeps_the_residual_of_every_run(make_gate):
    figure = heatmap_figure(make_report([make_gate("two"), make_gate("three", 0.5, heads=3)]))
    assert "residual (mm)" in texts(figure)


def test_labels_of_runs_at_one_place_do_not_collide(make_gate):
    """Twenty runs on the floor, where labels beside their points used to overlap."""
    gates = [make_gate(f"independent {seed}", seed=seed, config={"seed": seed}, pairs=60) for seed in range(20)]
    figure = region_figure(make_report(gates))
    figure.savefig(io.BytesIO(), format="png")
    labels = [text for text in figure.axes[0].texts if text.get_text().startswith("independent")]
    # The words alone, without the line that joins them to their point.
    boxes = [Text.get_window_extent(text) for text in labels]
    assert len(boxes) == 20
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))
    assert all(box.x0 > figure.axes[0].get_window_extent().x1 for box in boxes)


@given(st.lists(st.floats(0, 1), max_size=12).map(sorted), st.floats(0.001, 0.08))
def test_spaced_positions_keep_their_order_their_distance_and_the_room(positions, gap):
    placed = spaced(positions, gap)
    assert (np.diff(placed) >= gap - 1e-9).all()
    assert ((placed >= -1e-9) & (placed <= 1 + 1e-9)).all()
    if all(b - a >= gap for a, b in pairwise(positions)):
        assert placed == pytest.approx(positions)


def test_ticks_of_long_labelled_runs_do_not_collide(make_gate):
    """Labels squeezed the close-up until "-0.04" ran into "-0.02"."""
    name = "v3 pose_consistency_3_rotation_1, 20000 steps (position-rotation), {}"
    gates = [make_gate(name.format(n), couple, flip=n == 2, seed=n) for n, couple in enumerate((0.0, 0.9, 0.5))]
    figure = forest_figure(make_report(gates))
    figure.savefig(io.BytesIO(), format="png")
    for ax in figure.axes:
        boxes = [label.get_window_extent() for label in ax.get_xticklabels() if label.get_text()]
        assert len(boxes) > 2
        assert not any(left.overlaps(right) for left, right in pairwise(boxes))


def test_ticks_of_neighbouring_numbers_of_steps_do_not_collide(make_gate):
    report = make_report([make_gate("a"), make_gate("b", seed=1)])
    crowded = [replace(curve, points=tuple(replace(p, nfe=n) for p, n in zip(curve.points, (19, 20), strict=True)))
               for curve in report.nfe_curves]  # fmt: skip
    (effect, _) = sensitivity_figure(crowded).axes
    assert [text.get_text() for text in effect.get_xticklabels()] == ["19"]
