"""The picture of a study: its cells at the end of their runs, or their way there."""

from __future__ import annotations

import pytest

from dualhead_eval.gate import write_gate
from dualhead_eval.gate.compact import compact_gate
from dualhead_eval.studies.study_figure import study_figure
from dualhead_eval.studies.study_references import StudyReferences

NONE = StudyReferences([])


def titles(figure):
    return [axis.get_title() for axis in figure.axes]


def test_rows_with_three_checkpoints_are_drawn_over_steps_where_the_study_asks_for_it(cell):
    way = [cell("G", [0.3, 0.4, 0.5], step=step) for step in (250, 500, 1000)]
    assert "over steps" in titles(study_figure(way, NONE, "steps"))[0]
    assert titles(study_figure(way, NONE, "rho")) == ["", ""]
    (label,) = [tick.get_text() for tick in study_figure(way, NONE).axes[0].get_yticklabels()]
    assert label == "ring/G-1k"  # the end of the runs, not the way there


def test_without_three_checkpoints_there_are_no_curves(cell):
    assert titles(study_figure([cell("G", [0.3, 0.4])], NONE, "steps")) == ["", ""]


def test_nothing_that_can_be_read_is_nothing_to_draw(cell):
    with pytest.raises(ValueError, match="no cell has a defined rho"):
        study_figure([cell("G", [0.3, 0.4], valid=0.2)], NONE)


@pytest.mark.parametrize(
    ("conditions", "legend"),
    [(30, "exact optimum"), (12, "exact optimum, on fewer conditions (the table counts them)")],
)
def test_an_optimum_of_fewer_conditions_than_the_cells_is_told_apart(cell, make_gate, tmp_path, conditions, legend):
    own = cell("B", [0.2, 0.3], config={"source_noise_beta": 0.0, "kinematic_map": "ring/nullspace"})
    reference = make_gate("exact", couple=0.3, conditions=conditions, method="exact reference",
                          coupling={"source_noise_beta": 0.0}, kinematic_map="ring/nullspace")  # fmt: skip
    write_gate(compact_gate(reference), tmp_path / "exact.gate.json.gz")
    figure = study_figure([own], StudyReferences([tmp_path]))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ours, seeds", "paper", legend]
