"""Criteria of a study on cells of known coordination: what holds, what does not, what cannot be said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.evaluation.rollouts import ClosedLoop, ModeOutcome
from dualhead_eval.gate.compact import compact_gate
from dualhead_eval.gate.file import write_gate
from dualhead_eval.statistics.run import open_run
from dualhead_eval.studies.closed_loop_store import LoopResult
from dualhead_eval.studies.grading import grade_study
from dualhead_eval.studies.grading.printed_cells import collapse_row, grid_row, pose_row, printed_number
from dualhead_eval.studies.grading.single_cells import shared_noise_law
from dualhead_eval.studies.study_file import StudyFile
from dualhead_eval.studies.study_plan import StudyLoop, StudyRun
from dualhead_eval.studies.study_references import StudyReferences
from dualhead_eval.studies.study_table import COLUMNS, csv_text, study_rows
from dualhead_eval.studies.third_head_table import third_head_table


def graded(cells, criterion, reference=lambda cell: None, loops=()):
    rows = sorted({cell.configuration for cell in cells} | set(criterion["rows"]))
    content = {
        "title": "t",
        "question": "q",
        "datasets": {name: {"env": "RotatingRing-v2"} for name in dict.fromkeys(cell.dataset for cell in cells)},
        "banks": {name: {} for name in dict.fromkeys(cell.bank for cell in cells)},
        "runs": [{"importance": 1, "configurations": [{"name": row} for row in rows], "seeds": [0], "steps": 1000}],
        "criteria": [{"name": "n", "claim": "c", "criterion": "c", **criterion}],
    }
    (grade,) = grade_study(StudyFile.model_validate(content), cells, reference, loops)
    return grade


def test_equivalence_holds_at_the_floor_and_fails_outside(cell):
    criterion = {"test": "equivalence", "rows": ["A"], "margin": 0.04}
    assert graded([cell("A", [0, 0, 0])], criterion).grade == "holds"
    assert graded([cell("A", [0.3, 0.3, 0.3])], criterion).grade == "does not hold"
    assert graded([cell("A", [0, 0.1, -0.1])], criterion).grade == "inconclusive"
    alone = graded([cell("A", [0.0])], criterion)
    assert alone.grade == "not graded"
    assert alone.shortage == ("ring/A-1k: seed 1 missing, seed 2 missing",)


def test_a_criterion_does_not_hold_for_rows_that_were_not_run(cell):
    criterion = {"test": "equivalence", "rows": ["A", "D"], "margin": 0.04}
    grade = graded([cell("A", [0, 0, 0])], criterion)
    assert grade.grade == "inconclusive"
    assert "D: no run" in grade.shortage


def test_seeds_whose_validity_is_too_low_are_not_read(cell):
    criterion = {"test": "equivalence", "rows": ["A"], "margin": 0.04}
    grade = graded([cell("A", [0, 0, 0], valid=0.8)], criterion)
    assert grade.grade == "not graded"
    assert "3 of 3 seeds cannot be read" in grade.shortage[0]


def test_signs(cell):
    both, up = {"test": "signs", "rows": ["B"]}, {"test": "signs", "rows": ["B"], "expect": "positive"}
    mixed, positive = cell("B", [0.2, -0.2, 0.2]), cell("B", [0.2, 0.2, 0.2])
    assert graded([mixed], both).grade == "holds"
    assert graded([positive], both).grade == "does not hold"
    assert graded([positive], up).grade == "holds"
    assert graded([mixed], up).grade == "does not hold"


def test_corner_needs_effect_and_capacity(cell):
    criterion = {"test": "corner", "rows": ["K"]}
    assert graded([cell("K", [1, 1, 1])], criterion).grade == "holds"
    assert graded([cell("K", [0.5, 0.5, 0.5])], criterion).grade == "does not hold"
    assert graded([cell("K", [1, 1, 1], prior=[0.95, 0.05])], criterion).grade == "does not hold"


def test_capacity_against_the_targets_own(cell):
    skewed = cell("A", [0, 0, 0], prior=[0.8, 0.2], target=[0.8, 0.2])
    assert skewed.target_capacity == pytest.approx(0.32)
    near = {"test": "capacity", "of": "target", "within": 0.05, "rows": ["A"]}
    assert graded([skewed], near).grade == "holds"
    assert graded([skewed], near | {"within": None, "below": {"ring": 0.5}}).grade == "does not hold"
    assert graded([skewed], near | {"within": None, "below": {"ring": 0.5}, "of": "absolute"}).grade == "holds"
    assert graded([skewed], near | {"within": None, "at_least": 0.8, "of": "maximum"}).grade == "does not hold"


def test_capacity_is_not_read_where_few_pairs_are_valid(cell):
    criterion = {"test": "capacity", "rows": ["A"], "of": "maximum", "at_least": 0.8}
    assert graded([cell("A", [0.0, 0.0, 0.0])], criterion).grade == "holds"
    found = graded([cell("A", [0.0, 0.0, 0.0], valid=0.5)], criterion)
    assert found.grade == "not graded"
    assert "not read: 0." in found.evidence


def test_rows_of_different_budgets_are_not_compared(cell):
    short, base, longer = (
        cell("G", [0.4, 0.42, 0.38]),
        cell("B", [0.0, 0.02, -0.02]),
        cell("G", [0.9, 0.92, 0.88], budget=5000),
    )
    criterion = {"test": "difference", "rows": ["G"], "baseline": ["B"]}
    said = graded([short, longer, base], criterion).cells
    assert said == graded([short, base], criterion).cells
    assert graded([longer, base], criterion).cells == ()
    ladder = {"test": "monotone", "rows": ["B", "G"]}
    assert graded([short, longer, base], ladder).cells == graded([short, base], ladder).cells
    share = {"test": "accounts", "rows": ["X"], "whole": "G", "baseline": ["B"], "share": 0.5}
    half = cell("X", [0.3, 0.32, 0.28])
    assert graded([short, longer, base, half], share).cells == graded([short, base, half], share).cells


def test_a_difference_needs_its_effect_and_its_cost(cell):
    criterion = {"test": "difference", "rows": ["G"], "baseline": ["B"]}
    base = cell("B", [0, 0, 0], valid=1.0)
    assert graded([base, cell("G", [0.4, 0.4, 0.4], valid=0.96)], criterion).grade == "holds"
    assert graded([base, cell("G", [0.4, 0.4, 0.4], valid=1.0)], criterion).grade == "does not hold"
    free = graded([base, cell("G", [0.4, 0.4, 0.4], valid=1.0)], criterion | {"cost": False})
    assert free.grade == "holds"
    assert "rho +4" in free.evidence
    alike = {"test": "difference", "rows": ["G"], "baseline": ["B"], "statistic": "valid_rate", "within": 0.01}
    assert graded([base, cell("G", [0.4, 0.4, 0.4], valid=1.0)], alike).grade == "holds"
    assert graded([base, cell("G", [0.4, 0.4, 0.4], valid=0.96)], alike).grade == "does not hold"


def test_one_departure_alone_accounts_for_a_share(cell):
    criterion = {"test": "accounts", "rows": ["X", "Y"], "whole": "P", "baseline": ["G"], "share": 0.5}
    cells = [cell("G", [0, 0, 0]), cell("P", [0.6, 0.6, 0.6]), cell("X", [0.1, 0.1, 0.1])]
    assert graded([*cells, cell("Y", [0.5, 0.5, 0.5])], criterion).grade == "holds"
    assert graded([*cells, cell("Y", [0.2, 0.2, 0.2])], criterion).grade == "does not hold"


def test_a_ladder_rises_at_every_step(cell):
    criterion = {"test": "monotone", "rows": ["a", "b", "c"]}
    rungs = [cell("a", [-0.3] * 3), cell("b", [0.0] * 3)]
    assert graded([*rungs, cell("c", [0.3] * 3)], criterion).grade == "holds"
    assert graded([*rungs, cell("c", [-0.2] * 3)], criterion).grade == "does not hold"
    assert graded(rungs, criterion).grade == "inconclusive"


def test_an_interaction_over_maps(cell):
    criterion = {"test": "interaction", "rows": ["B"], "baseline": ["A"]}

    def arms(seeds):
        planned = range(seeds)
        return [
            cell(name, [couple] * seeds, dataset=dataset, planned=planned)
            for dataset, effect in (("ring-x", -0.3), ("ring-y", 0.6))
            for name, couple in (("A", 0), ("B", effect))
        ]

    # Two maps and five seeds cannot reach 5 % where labels are exchanged within seeds; seven can.
    few = graded(arms(5), criterion)
    assert "p = " in few.evidence
    assert few.grade == "inconclusive"
    assert graded(arms(7), criterion).grade == "holds"


def test_a_sign_that_banks_do_not_share_is_a_property_of_the_conditions(cell):
    criterion = {"test": "sign_on_banks", "rows": ["B"], "baseline": ["A"], "banks": ["frozen", "large"],
                 "expect": "negative", "margin": 0.05}  # fmt: skip
    frozen = [cell("A", [0] * 3), cell("B", [-0.3] * 3)]
    same = [cell("A", [0] * 3, bank="large"), cell("B", [-0.3] * 3, bank="large")]
    none = [cell("A", [0] * 3, bank="large"), cell("B", [0.0] * 3, bank="large")]
    assert graded([*frozen, *same], criterion).grade == "holds"
    assert graded([*frozen, *none], criterion).grade == "does not hold"


def test_an_effect_that_stays_or_falls_with_steps(cell):
    criterion = {"test": "trend", "rows": ["G"], "from": 500, "to": 1000, "margin": 0.05}
    early = cell("G", [0.6] * 3, step=500)
    assert graded([early, cell("G", [0.6] * 3)], criterion).grade == "holds"
    fallen = graded([early, cell("G", [0.2] * 3)], criterion)
    assert fallen.grade == "does not hold"
    assert "at 500" in fallen.evidence


def test_an_effect_paid_for_in_validity(cell):
    criterion = {"test": "order", "rows": ["G"], "at_most": -0.7}
    cells = [cell("G", [rho] * 3, step=step, valid=valid, partition="bypass-v2")
             for step, rho, valid in ((200, 0.8, 0.4), (500, 0.5, 0.6), (1000, 0.2, 0.9))]  # fmt: skip
    assert graded(cells, criterion).grade == "holds"
    turned = [cell("G", [rho] * 3, step=step, valid=valid, partition="bypass-v2")
              for step, rho, valid in ((200, 0.2, 0.4), (500, 0.5, 0.6), (1000, 0.8, 0.9))]  # fmt: skip
    assert graded(turned, criterion).grade == "does not hold"


def test_a_draw_that_repairs_frequency_and_effect(cell):
    criterion = {"test": "repairs", "rows": ["learned"], "baseline": ["uniform"]}
    target = [0.8, 0.2]
    uniform = cell("uniform", [0.4] * 3, target=target)
    repaired = cell("learned", [0.9] * 3, prior=target, target=target)
    assert graded([uniform, repaired], criterion).grade == "holds"
    weaker = cell("learned", [0.1] * 3, prior=target, target=target)
    assert graded([uniform, weaker], criterion).grade == "does not hold"


@pytest.mark.parametrize(("kept", "grade"), [(0.01, "holds"), (0.5, "does not hold")])
def test_entropy_and_capacity_of_a_collapse_beside_the_paper(cell, kept, grade):
    # KL weight 0.01 at p = .92: the paper's heads keep C / max C .006 and entropy / ln K .017.
    built = cell("A", [0.0, 0.0], target=[0.92, 0.08], config={"latent": "posterior", "kl_weight": 0.01})
    runs = []
    for run in built.runs:
        counts = np.zeros_like(run.gate.counts)
        counts[..., 0, 0], counts[..., 1, 1] = round(1000 * (1 - kept)), round(1000 * kept)
        runs.append(open_run(replace(run.gate, counts=counts, strata={})))
    built = replace(built, runs=tuple(runs))
    for statistic in ("relative_capacity", "relative_entropy"):
        found = graded([built], {"test": "beside", "rows": ["A"], "margin": 0.1, "statistic": statistic})
        assert found.grade == grade
        assert "paper 0.0" in found.evidence


def test_the_paper_beside_a_cell(cell):
    setting = {"config": {"source_noise_beta": 0.0, "kinematic_map": "ring/nullspace"}}
    criterion = {"test": "beside", "rows": ["B"], "margin": 0.05}
    near, far = cell("B", [-0.23] * 3, **setting), cell("B", [0.23] * 3, **setting)
    assert near.paper_row == "testbed/B shared source noise/nullspace"
    assert graded([near], criterion).grade == "holds"
    assert graded([far], criterion).grade == "does not hold"


@pytest.mark.parametrize(
    ("representation", "law"),
    [
        ("nullspace", -0.2276),
        ("overlap+90", 0.7129),
        ("rotation+90", 0.0),
        ("rotation+120", -1 / 3),
        ("rotation+0", 1.0),
        ("orthogonal", None),
        ("polar", None),
    ],
)
def test_the_law_of_shared_noise_under_a_linear_map(make_gate, representation, law):
    gate = make_gate(config={"source_noise_beta": 0.0, "kinematic_map": f"ring/{representation}"})
    assert shared_noise_law(gate) == (None if law is None else pytest.approx(law, abs=1e-4))


def test_an_effect_follows_the_law_or_not(cell):
    criterion = {"test": "law", "rows": ["B"], "margin": 0.05}
    setting = {"config": {"source_noise_beta": 0.0, "kinematic_map": "ring/rotation+120"}}
    assert graded([cell("B", [-0.33] * 3, **setting)], criterion).grade == "holds"
    assert graded([cell("B", [0.33] * 3, **setting)], criterion).grade == "does not hold"


def test_rows_of_the_collapse_table(make_gate):
    config = {"latent": "posterior", "kl_weight": 1.0, "free_bits": 0.1}
    gate = make_gate(config=config, dataset={"env_kwargs": {"path_spread": 0.08}})
    gate = replace(gate, target_probabilities=np.array([0.8, 0.2]))
    assert collapse_row(gate) == "testbed skew/posterior kl1 fb0.1/p0.80"
    assert printed_number(gate, "tab:collapse", "C_rel") == 0.259
    tight = make_gate(
        config=config | {"kl_weight": 0.01, "free_bits": 0.0}, dataset={"env_kwargs": {"path_spread": 0.16}}
    )
    tight = replace(tight, target_probabilities=np.array([0.5, 0.5]))
    assert collapse_row(tight) == "testbed skew/posterior kl0.01/tight p0.50"
    assert collapse_row(make_gate()) == ""


def test_a_mechanism_that_the_paper_did_not_run_names_no_row_of_it(cell):
    setting = {"partition": "bypass-v2", "config": {"source_noise_beta": 0.1, "consistency_weight": 3.0}}
    assert cell("G", [0.3], **setting).paper_row == "v2/consistency beta0.1 lambda3"
    setting["config"]["consistency_weight"] = 1.0
    assert cell("G", [0.3], **setting).paper_row == ""


def test_a_cell_of_the_grid_beside_the_papers_pooled_effect(cell):
    criterion = {"test": "beside", "rows": ["G"], "margin": 0.03, "statistic": "delta_pooled"}
    setting = {"partition": "bypass-v2", "config": {"source_noise_beta": 0.1, "consistency_weight": 3.0}}
    near = graded([cell("G", [0.3] * 3, **setting)], criterion)  # an effect of .15 where half agree by chance
    assert (near.grade, near.evidence.endswith("paper +0.152")) == ("holds", True)
    assert graded([cell("G", [0.6] * 3, **setting)], criterion).grade == "does not hold"
    unprinted = setting | {"config": {"source_noise_beta": 0.5, "consistency_weight": 3.0}}
    assert graded([cell("G", [0.3] * 3, **unprinted)], criterion).grade == "not graded"


def test_only_two_heads_without_token_and_latent_are_cells_of_the_grid(make_gate):
    config = {"source_noise_beta": 0.0, "consistency_weight": 0.3}
    assert grid_row(make_gate(partition="bypass-v2", config=config)) == "v2/grid beta0 lambda0.3/seed0"
    for other in ({"token": "window"}, {"latent": "prior"}, {"rotation_head": True}):
        assert grid_row(make_gate(partition="bypass-v2", config=config | other)) == ""
    assert grid_row(make_gate(partition="rotating-v3", config=config)) == ""


POSE = {
    "partition": "rotating-v3",
    "heads": 3,
    "config": {"rotation_head": True, "source_noise_beta": 0.0, "consistency_weight": 3.0},
}


def test_a_criterion_about_another_pair_of_heads(cell):
    # Position and rotation each copy the joint head; the test's pair is the one that is named.
    built = cell("pose", [0.8] * 3, **POSE)
    criterion = {"test": "minimum", "rows": ["pose"], "at_least": 0.7}
    assert graded([built], criterion).grade == "holds"
    indirect = graded([built], criterion | {"heads": ["position", "rotation"]})  # .8 x .8 = .64
    assert indirect.grade == "does not hold"
    assert indirect.cells[0].name == "ring/pose-1k position-rotation"
    with pytest.raises(ValueError, match="ring/A-1k has the heads joint, position, a criterion asks for"):
        graded([cell("A", [0.8] * 3)], criterion | {"rows": ["A"], "heads": ["joint", "rotation"]})


def test_the_effect_of_every_pair_of_three_heads_stands_beside_the_papers(cell, make_gate):
    assert pose_row(make_gate(**POSE)) == "v3/pose lambda_cons3 lambda_rot0/seed0"
    assert pose_row(make_gate(partition="rotating-v3")) == ""
    built = cell("pose", [0.7] * 3, **POSE)
    criterion = {"test": "beside", "rows": ["pose"], "margin": 0.03, "statistic": "delta"}
    assert graded([built], criterion).evidence.endswith("paper +0.335")
    other = graded([built], criterion | {"heads": ["joint", "rotation"]})
    assert (other.grade, other.evidence.endswith("paper +0.002")) == ("does not hold", True)
    table = third_head_table([built, cell("A", [0.0] * 3)])
    assert [row[1] for row in table.rows] == [
        "joint - position", "joint - rotation", "position - rotation", "all three",
    ]  # fmt: skip
    assert [row[5] for row in table.rows[:3]] == ["+0.335", "+0.002", "+0.028"]
    agree, chance, theirs = table.rows[3][6:]
    assert float(agree.split()[0]) == pytest.approx(0.25 + 0.75 * 0.7 * 0.7 + 0.25 * 2 * 0.7 * 0.3, abs=0.02)
    assert (float(chance), theirs) == (pytest.approx(0.25, abs=0.01), "0.430")
    assert third_head_table([cell("A", [0.0] * 3)]) is None


def test_a_reference_is_found_by_what_it_holds(cell, make_gate, tmp_path):
    setting = {"config": {"source_noise_beta": 0.0, "kinematic_map": "ring/nullspace"}}
    own = cell("B", [-0.2] * 3, **setting)
    reference = make_gate("exact", couple=0.2, flip=True, conditions=30, method="exact reference",
                          coupling={"source_noise_beta": 0.0}, kinematic_map="ring/nullspace")  # fmt: skip
    other = make_gate("other map", couple=0.6, conditions=30, method="exact reference",
                      coupling={"source_noise_beta": 0.0}, kinematic_map="ring/polar")  # fmt: skip
    for gate in (reference, other):
        write_gate(compact_gate(gate), tmp_path / f"{gate.label}.gate.json.gz")
    references = StudyReferences([tmp_path, tmp_path / "none"])
    found = references.find(own)
    assert found is not None
    assert found.rho == pytest.approx(-0.2, abs=0.05)
    assert (
        references.find(cell("A", [0] * 3, config={"source_noise_beta": 1.0, "kinematic_map": "ring/nullspace"}))
        is None
    )
    criterion = {"test": "exact", "rows": ["B"], "margin": 0.05}
    assert graded([own], criterion, references.rho).grade == "holds"
    assert graded([own], criterion).grade == "not graded"


def test_the_tidy_table_has_a_row_per_run_and_leaves_what_is_undefined_empty(cell):
    collapsed = cell("E", [1, 1, 1], prior=[1.0, 0.0])
    rows = study_rows([collapsed], StudyReferences([]))
    assert [row["seed"] for row in rows] == [0, 1, 2]
    header, *lines = csv_text(rows).splitlines()
    assert header == ",".join(COLUMNS)
    values = dict(zip(COLUMNS, lines[0].split(","), strict=True))
    assert values["rho"] == ""
    assert float(values["capacity"]) == 0
    assert np.isnan(rows[0]["rho"])


def driven(row, *ways):
    """A closed loop of the joint head whose ways have (successes, episodes)."""
    successes, episodes = (sum(way[i] for way in ways) for i in (0, 1))
    modes = tuple(ModeOutcome(mode, of, good) for mode, (good, of) in enumerate(ways))
    run = StudyRun("ring", row, None, {}, 0, 1000, (1000,), 1)
    outcome = ClosedLoop("RotatingRing-v2", "joint", episodes, successes, 0, modes=modes)
    return LoopResult(StudyLoop(run, "joint", episodes, 0, 1), outcome)


@pytest.mark.parametrize(
    ("ways", "grade"),
    [
        ([(50, 50), (50, 50), (50, 50)], "holds"),
        ([(50, 50), (50, 50), (30, 50)], "does not hold"),  # [0.46, 0.72] by the third way
        ([(40, 50), (40, 50), (40, 50)], "does not hold"),  # 0.80 [0.73, 0.86] of all
        ([(50, 50), (50, 50), (44, 50)], "inconclusive"),  # 0.88 [0.76, 0.94] by the third way
        ([(75, 75), (75, 75), (0, 0)], "does not hold"),  # a way that no episode took
    ],
)
def test_a_head_drives_by_every_way_or_not(cell, ways, grade):
    criterion = {"test": "closed_loop", "rows": ["A"], "at_least": 0.9, "each_way_at_least": 0.8}
    found = graded([cell("A", [0.1])], criterion, loops=[driven("A", *ways), driven("B", (0, 9), (0, 9), (0, 9))])
    assert found.grade == grade
    assert [one.name for one in found.cells] == ["ring/A-1k seed 0, joint head"]  # of its own rows alone


def test_a_row_that_did_not_drive_leaves_its_criterion_open(cell):
    criterion = {"test": "closed_loop", "rows": ["A", "B"], "at_least": 0.9, "each_way_at_least": 0.8}
    found = graded([cell("A", [0.1]), cell("B", [0.1])], criterion, loops=[driven("A", (90, 90), (90, 90))])
    assert (found.grade, found.shortage) == ("inconclusive", ("B: no run",))
