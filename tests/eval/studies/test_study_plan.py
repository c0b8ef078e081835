"""Studies as files: what they may hold, and the runs and evaluations that follow from them."""

from pathlib import Path

import pytest
import yaml

from dualhead_eval.studies.shared_checkpoints import share_checkpoints
from dualhead_eval.studies.study_file import read_study
from dualhead_eval.studies.study_plan import join_plans, plan_study

STUDIES = sorted((Path(__file__).parents[3] / "studies").glob("*.yaml"))

SMALL = {
    "title": "Small",
    "question": "Does it work?",
    "datasets": {"ring": {"env": "RotatingRing-v2", "episodes": 100, "conditions": 8}},
    "banks": {"frozen": {}, "few": {"conditions": 4, "pairs": 8}},
    "runs": [
        {
            "importance": 2,
            "configurations": [{"name": "A", "flags": {"policy.source_noise_beta": 1.0}}, {"name": "B"}],
            "seeds": [0, 1],
            "steps": 400,
            "evaluate_at": [100, 400],
        },
        {"importance": 1, "configurations": ["configs/v2/A_independent.yaml"], "seeds": [0], "steps": [1000, 2000]},
        {"importance": 3, "configurations": [{"name": "B"}], "seeds": [0], "steps": 400, "banks": ["few"]},
        {"importance": 9, "configurations": [{"name": "B"}], "seeds": [0], "steps": 8000, "later": True},
    ],
    "criteria": [
        {"name": "floor", "test": "equivalence", "claim": "c", "criterion": "c", "rows": ["A"], "margin": 0.02}
    ],
}

DRIVEN = {"rows": ["B"], "controls": ["joint", "position"], "episodes": 9}


def written(folder, **changes):
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(SMALL | changes, sort_keys=False))
    return path


def small(folder, **changes):
    return read_study(written(folder, **changes))


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_every_study_plans_runs_of_configurations_that_exist(path):
    study = read_study(path)
    plan = plan_study(study)
    assert {run.dataset for run in plan.runs} == set(study.datasets)
    assert all(Path(__file__).parents[3].joinpath(run.config).is_file() for run in plan.runs if run.config)
    planned = {(evaluation.run.name, evaluation.step) for evaluation in plan.evaluations}
    assert planned == {(run.name, step) for run in plan.runs for step in run.checkpoints}
    smoke = plan_study(study, smoke=True)
    assert 0 < len(smoke.runs) < len(plan.runs)
    assert max(run.steps for run in smoke.runs) == study.smoke.steps


def test_all_studies_agree_on_what_they_share():
    plans = [plan_study(read_study(path), later=True) for path in STUDIES]
    joined = join_plans(plans)
    assert len(joined.runs) < sum(len(plan.runs) for plan in plans)
    assert [run.importance for run in joined.runs] == sorted(run.importance for run in joined.runs)
    assert len({evaluation.gate_file for evaluation in joined.evaluations}) == len(joined.evaluations)


def test_a_shared_run_is_planned_once_with_every_checkpoint_and_bank(tmp_path):
    plan = plan_study(small(tmp_path))
    names = [run.name for run in plan.runs]
    assert len(names) == len(set(names)) == 4 + 2
    assert names[0] == "ring/A_independent-1k/seed-0"
    files = {str(e.gate_file) for e in plan.evaluations if e.run.name == "ring/B-400/seed-0"}
    assert files == {
        f"ring/B-400/seed-0/{name}.gate.json.gz" for name in ("000100-frozen", "000400-frozen", "000400-few")
    }
    assert "ring/B-8k/seed-0" in {run.name for run in plan_study(small(tmp_path), later=True).runs}


def test_a_run_trains_as_a_sweep_would(tmp_path):
    run = plan_study(small(tmp_path)).runs[-1].sweep_run(tmp_path)
    assert run.save_at == (100, 400)
    assert run.dataset == str(tmp_path / "ring" / "train")
    assert {"--steps=400", "--save_freq=400", "--seed=1"} <= set(run.arguments)


def test_a_training_saves_what_other_studies_evaluate_of_it(tmp_path):
    plan = plan_study(small(tmp_path, runs=[SMALL["runs"][0] | {"evaluate_at": [400]}]))
    beside = plan_study(small(tmp_path, runs=[SMALL["runs"][0] | {"seeds": [1], "evaluate_at": [50, 100]}]))
    shared = {run.name: run.sweep_run(tmp_path).save_at for run in share_checkpoints(plan, [beside]).runs}
    assert shared["ring/A-400/seed-0"] == (400,)
    assert shared["ring/A-400/seed-1"] == shared["ring/B-400/seed-1"] == (50, 100, 400)
    assert share_checkpoints(plan, [beside]).evaluations == plan.evaluations
    for other in ({"flags": {"batch_size": 7}}, {"datasets": {"ring": {"env": "RotatingRing-v2", "episodes": 7}}}):
        another = plan_study(small(tmp_path, runs=[SMALL["runs"][0] | {"evaluate_at": [50]}], **other))
        assert share_checkpoints(plan, [another]) == plan


def test_a_resampled_row_is_its_own_run_of_another_rows_training(tmp_path):
    block = {
        "importance": 1,
        "configurations": [{"name": "A"}],
        "resampled": [{"name": "B", "of": "A", "source_noise_beta": 0.0}],
        "seeds": [0, 1],
        "steps": 400,
    }
    plan = plan_study(small(tmp_path, runs=[block]))
    rows = [run for run in plan.runs if run.configuration == "B"]
    assert [run.name for run in rows] == ["ring/B-400/seed-0", "ring/B-400/seed-1"]
    assert [run.name for run in plan.trainings(rows)] == ["ring/A-400/seed-0", "ring/A-400/seed-1"]
    assert {run.coupling.source_noise_beta for run in rows} == {0.0}
    drawn = block | {"resampled": [{"name": "H", "of": "A", "token_draw": "uniform"}]}
    rows = [run for run in plan_study(small(tmp_path, runs=[drawn])).runs if run.configuration == "H"]
    assert {run.coupling.token_draw for run in rows} == {"uniform"}


def test_a_closed_loop_is_the_end_of_a_run_and_a_head_that_drives(tmp_path):
    blocks = [SMALL["runs"][0] | {"closed_loops": DRIVEN}, SMALL["runs"][2] | {"closed_loops": DRIVEN}]
    plan = plan_study(small(tmp_path, runs=blocks))
    files = [f"ring/B-400/seed-0/000400-{control}.rollouts.json.gz" for control in ("joint", "position")]
    assert [loop.file.as_posix() for loop in plan.loops] == files  # the first seed's, and each once
    assert {(loop.run.name, loop.episodes, loop.importance) for loop in plan.loops} == {("ring/B-400/seed-0", 9, 2)}
    asked = {"importance": 1, "closed_loops": DRIVEN | {"seeds": [0, 1], "rows": ["A", "B"]}}
    every = small(tmp_path, runs=[SMALL["runs"][0] | asked])
    assert len(plan_study(every).loops) == 8
    smoke = plan_study(every, smoke=True)
    assert {(loop.run.seed, loop.episodes) for loop in smoke.loops} == {(0, every.smoke.closed_loop_episodes)}
    with pytest.raises(ValueError, match="no block of importance 1 or more for its smoke form"):
        plan_study(small(tmp_path, runs=blocks), smoke=True)
    longer = SMALL["runs"][2] | {"closed_loops": DRIVEN | {"episodes": 10}}
    with pytest.raises(ValueError, match=r"the closed loop .*joint.* is given twice and differs"):
        plan_study(small(tmp_path, runs=[blocks[0], longer]))


def test_one_name_for_two_things_is_refused(tmp_path):
    blocks = [*SMALL["runs"], SMALL["runs"][2] | {"configurations": [{"name": "B", "flags": {"batch_size": 7}}]}]
    with pytest.raises(ValueError, match="the run ring/B-400/seed-0 is given twice and differs"):
        plan_study(small(tmp_path, runs=blocks))
    other = small(tmp_path, datasets={"ring": {"env": "RotatingRing-v2", "episodes": 7}})
    with pytest.raises(ValueError, match="the dataset ring is given twice"):
        join_plans([plan_study(small(tmp_path)), plan_study(other)])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"criteria": [SMALL["criteria"][0] | {"rows": ["C"]}]}, "names the row 'C'"),
        ({"criteria": [SMALL["criteria"][0] | {"test": "guess"}]}, "criteria.0"),
        ({"criteria": SMALL["criteria"] * 2}, "two criteria of one name"),
        ({"runs": [SMALL["runs"][2] | {"banks": ["none"]}]}, "names the bank 'none'"),
        ({"runs": [SMALL["runs"][2] | {"evaluate_at": [500]}]}, "beyond its budget of 400 steps"),
        ({"runs": [SMALL["runs"][2] | {"seeds": [-1]}]}, "greater than or equal to 0"),
        (
            {"runs": [SMALL["runs"][2] | {"resampled": [{"name": "D", "of": "C", "source_noise_beta": 0.0}]}]},
            "is of .C., expected one",
        ),
        ({"runs": [SMALL["runs"][2] | {"resampled": [{"name": "D", "of": "B"}]}]}, "samples as .B. does"),
        (
            {
                "runs": [
                    SMALL["runs"][2]
                    | {"resampled": [{"name": "D", "of": "B", "draws": "joint", "token_draw": "uniform"}]}
                ]
            },
            "couples heads and pairs draws of one",
        ),
        ({"runs": [SMALL["runs"][2] | {"closed_loops": DRIVEN | {"rows": ["A"]}}]}, "closed_loops: names the row 'A'"),
        ({"runs": [SMALL["runs"][2] | {"closed_loops": DRIVEN | {"seeds": [7]}}]}, "closed_loops: names the seed 7"),
        ({"runs": [SMALL["runs"][2] | {"closed_loops": DRIVEN | {"controls": ["hand"]}}]}, "controls"),
        ({"surprise": 1}, "unknown field 'surprise'"),
    ],
)
def test_a_study_that_contradicts_itself_is_refused(tmp_path, changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        small(tmp_path, **changes)


def test_what_is_no_study_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(FileNotFoundError, match="expected a study's YAML file"):
        read_study(tmp_path / "none.yaml")
    path = tmp_path / "torn.yaml"
    path.write_text("title: [")
    with pytest.raises(ValueError, match="is not YAML"):
        read_study(path)
    path.write_bytes(b" " * (2**20 + 1))
    with pytest.raises(ValueError, match="at most"):
        read_study(path)
