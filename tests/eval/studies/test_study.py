"""A real study of the ring at a tiny budget: from nothing to its verdict, and what it does with what it finds."""

from __future__ import annotations

import csv
import gzip
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from small_study import STUDY, command, contents, write_study

from dualhead_eval.cli import main
from dualhead_eval.evaluation.rollouts import read_closed_loop
from dualhead_eval.gate import read_gate, write_gate
from dualhead_eval.studies.gate_store import GateStore, study_results
from dualhead_eval.studies.study_file import read_study
from dualhead_eval.studies.study_plan import plan_study


def test_a_study_goes_from_its_file_to_its_verdict(finished):
    gates = sorted(path.relative_to(finished / "results" / "gates").as_posix() for path in _gates(finished))
    on_the_way = ("000050-frozen", "000150-frozen")
    asked = [(row, point) for row in ("A_independent", "B_shared_noise") for point in on_the_way]
    asked += [(row, "000150-large") for row in ("A_independent", "B_shared_noise", "B_in_sampling", "one_head")]
    assert gates == sorted(
        f"ring/{row}-150/seed-{seed}/{point}.gate.json.gz" for row, point in asked for seed in (0, 1)
    )
    rows = list(csv.DictReader((finished / "results" / "small" / "table.csv").open()))
    assert len(rows) == len(gates)
    assert {row["paper_row"] for row in rows} == {
        "testbed/A independent/nullspace",
        "testbed/B shared source noise/nullspace",
        "",  # draws of one head
    }
    for row in rows:
        assert 0 < float(row["valid_rate"]) <= 1
        assert float(row["final_loss"]) > 0
        assert row["plateaued"] in ("true", "false")
        assert (row["device"], row["precision"]) == ("cpu", "fp32")
        assert len(row["dataset_fingerprint"]) == len(row["training_fingerprint"]) == 64
    assert {float(row["exact_rho"]) < -0.1 for row in rows if row["configuration"] == "B_shared_noise"} == {True}
    assert (finished / "results" / "small" / "figure.png").stat().st_size > 10_000


def test_the_first_seed_drives_with_either_head(finished):
    recorded = finished / "runs/closed_loops/ring/A_independent-150/seed-0"
    assert sorted(path.name for path in recorded.iterdir()) == ["000150-joint", "000150-position"]
    for control in ("joint", "position"):
        file = finished / f"results/closed_loops/ring/A_independent-150/seed-0/000150-{control}.rollouts.json.gz"
        assert read_closed_loop(file)[1] == read_closed_loop(recorded / f"000150-{control}")[1]
        assert (read_closed_loop(file)[1].episodes, read_closed_loop(file)[1].control) == (3, control)


def test_a_recording_that_is_there_is_not_made_again(finished, tmp_path, capsys):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True, symlinks=True)
    file = tmp_path / "results/closed_loops/ring/A_independent-150/seed-0/000150-joint.rollouts.json.gz"
    before, kept = file.read_bytes(), contents(tmp_path / "runs")
    file.unlink()
    assert main(command(tmp_path, "--verdict-only")) == 0
    said = capsys.readouterr().out
    assert "1 of 2 closed loops are there" in said
    assert "missing ring/A_independent-150, seed 0: 000150-joint.rollouts.json.gz" in said
    assert main(command(tmp_path)) == 0
    assert file.read_bytes() == before
    assert contents(tmp_path / "runs") == kept


def test_closed_loops_of_something_else_are_refused(copied, capsys):
    folder = copied / "results/closed_loops/ring/A_independent-150/seed-0"
    joint, position = (folder / f"000150-{control}.rollouts.json.gz" for control in ("joint", "position"))
    whole = joint.read_bytes()
    shutil.copy(position, joint)
    assert main(command(copied, "--verdict-only")) == 2
    assert "environment's control 'position', expected 'joint'" in capsys.readouterr().err
    for change, sentence in (
        (lambda content: content["outcomes"].pop(), "number of episodes 2, expected 3"),
        (lambda content: content["outcomes"][0].update(seed=9), "first episode's seed 1, expected 0"),
        (lambda content: content["policy"].update(training_step=50), "training_step 50, expected 150"),
        (lambda content: content["policy"]["config"].update(token="oracle"), "policy.token 'oracle', expected None"),
        (lambda content: content["env_kwargs"].update(perturbation="action_noise"), "perturbation"),
        (lambda content: content["policy"].update(coupling={"source_noise_beta": 0.0}), "coupling"),
    ):
        content = json.loads(gzip.decompress(whole))
        change(content)
        joint.write_bytes(gzip.compress(json.dumps(content).encode()))
        assert main(command(copied, "--verdict-only")) == 2
        assert sentence in capsys.readouterr().err
    joint.write_bytes(whole[:-20])
    assert main(command(copied, "--verdict-only")) == 2
    assert "not a dataset of recorded rollouts" in capsys.readouterr().err


def test_a_resampled_row_trains_nothing_and_has_the_couplings_reference(finished):
    assert not (finished / "runs/ring/B_in_sampling-150").exists()
    gates = {
        row: read_gate(finished / f"results/gates/ring/{row}-150/seed-0/000150-large.gate.json.gz")
        for row in ("A_independent", "B_in_sampling")
    }
    assert {gate.provenance["run"]["name"] for gate in gates.values()} == {"ring/A_independent-150/seed-0"}
    with (finished / "results/small/table.csv").open() as file:
        exact = {
            row["configuration"]: float(row["exact_rho"])
            for row in csv.DictReader(file)
            if row["bank"] == "large" and row["configuration"] != "one_head"
        }
    assert exact["B_in_sampling"] < -0.1 < exact["A_independent"] < 0.1


def test_draws_of_one_head_are_coordinated_by_nothing_and_no_row_of_the_papers(finished):
    with (finished / "results/small/table.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["bank"] == "large"]
    one, two = ([row for row in rows if row["configuration"] == name] for name in ("one_head", "B_shared_noise"))
    assert all(float(row["exact_rho"]) < -0.1 for row in two)
    assert {(row["exact_rho"], row["paper_row"]) for row in one} == {("", "")}
    gate = read_gate(finished / "results/gates/ring/one_head-150/seed-0/000150-large.gate.json.gz")
    assert (gate.provenance["method"], gate.provenance["head"]) == ("draws of one policy", "position")


def test_a_checkpoint_on_the_way_is_judged_by_its_own_losses(finished):
    results = study_results(finished / "results" / "gates")
    store = {(r.configuration, r.seed, r.step): r.gate for r in results if r.bank == "frozen"}
    early, late = (store["A_independent", 0, step].provenance["training"] for step in (50, 150))
    assert early["final_loss"] != late["final_loss"]
    assert early["steps"] == late["steps"] == 150
    assert not store["A_independent", 0, 50].strata
    assert store["B_shared_noise", 1, 150].strata


def test_a_finished_study_changes_nothing_and_needs_neither_data_nor_runs(copied, capsys):
    before = contents(copied)
    assert main(command(copied)) == 0
    assert contents(copied) == before
    out = capsys.readouterr().out
    assert "16 of 16 evaluations are there" in out
    assert "floor" in out
    assert not (copied / "data").exists()


def test_what_is_trained_is_evaluated_before_more_is_trained(finished, tmp_path, capsys):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True, symlinks=True)
    runs = [Path("ring") / f"{row}-150" / "seed-1" for row in ("A_independent", "B_shared_noise")]
    for run in runs:
        (tmp_path / "results/gates" / run / "000150-frozen.gate.json.gz").unlink()
    (tmp_path / "runs" / runs[0] / "checkpoints/000150/pretrained_model/config.json").unlink()
    assert main(command(tmp_path)) == 2  # the sweep counts that run as finished
    said = capsys.readouterr()
    assert "evaluating 1 checkpoint\n" in said.out
    assert "training 1 run\n" in said.out
    assert "seed-1 is trained and has no checkpoint of step 150, which the study evaluates: move" in said.err
    assert [(tmp_path / "results/gates" / run / "000150-frozen.gate.json.gz").is_file() for run in runs] == [
        False,
        True,
    ]


def test_a_short_budget_is_spent_on_what_is_important(copied, capsys):
    large = copied / "results/gates/ring/A_independent-150/seed-0/000150-large.gate.json.gz"
    large.unlink()
    assert main(command(copied, "--importance", "1")) == 0  # what is missing has importance 2
    assert not large.exists()
    assert not (copied / "data").exists()
    out = capsys.readouterr().out
    assert "15 of 16 evaluations are there" in out
    assert "of importance 1 or more: 8 of 8" in out
    assert "missing ring" not in out  # nobody asked for it
    assert main(command(copied, "--importance", "0")) != 0
    assert "--importance 0 is none: give 1" in capsys.readouterr().err


def test_a_configuration_that_is_not_there_is_named(copied, capsys):
    blocks = [STUDY["runs"][0] | {"configurations": ["configs/none.yaml"], "closed_loops": None}]
    criteria = [STUDY["criteria"][0] | {"rows": ["none"]}]
    study = write_study(copied, runs=blocks, criteria=criteria)
    (copied / "results/gates/ring/none-150/seed-0").mkdir(parents=True)
    shutil.copy(next(_gates(copied)), copied / "results/gates/ring/none-150/seed-0/000150-frozen.gate.json.gz")
    assert main(command(copied, "--verdict-only", study=study)) == 2
    assert "configuration configs/none.yaml does not exist in" in capsys.readouterr().err


def test_missing_gate_files_are_named(copied, capsys):
    for path in (copied / "results" / "gates" / "ring" / "B_shared_noise-150" / "seed-1").iterdir():
        path.unlink()
    assert main(command(copied, "--verdict-only")) == 0
    out = capsys.readouterr().out
    assert "13 of 16 evaluations are there" in out
    assert "missing ring/B_shared_noise-150, seed 1: 000050-frozen.gate.json.gz, 000150-frozen.gate.json.gz, " in out
    assert "000150-large.gate.json.gz" in out
    assert "seed 1 missing" in out


def test_a_study_without_any_result_says_what_is_missing(tmp_path, capsys):
    write_study(tmp_path)
    assert main(command(tmp_path, "--verdict-only")) == 0
    out = capsys.readouterr().out
    assert "0 of 16 evaluations are there" in out
    assert "not graded" in out
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"flags": STUDY["flags"] | {"policy.velocity_width": 32}}, "policy.velocity_width 64, expected 32"),
        ({"flags": STUDY["flags"] | {"batch_size": 64}}, "batch_size 128, expected 64"),
        ({"banks": {"frozen": {"conditions": 6, "pairs": 65}, "large": {}}}, "pairs_per_condition 64, expected 65"),
        ({"banks": {"frozen": {"conditions": 5, "pairs": 64}, "large": {}}}, "conditions 6, expected 5"),
        (
            {"banks": {"frozen": {"conditions": 6, "pairs": 64, "seed": 9}, "large": {}}},
            "evaluation seed 0, expected 9",
        ),
        (
            {"banks": {"frozen": {"conditions": 6, "pairs": 64, "taus": [0.4]}, "large": {}}},
            r"taus \[0.55\], expected \[0.4, 0.55\]",
        ),
        (
            {"datasets": {"ring": STUDY["datasets"]["ring"] | {"env_kwargs": {"representation": "polar"}}}},
            "environment's representation 'nullspace', expected 'polar'",
        ),
        ({"datasets": {"ring": {"env": "RotatingRing-v4", "episodes": 9}}}, "expected 'RotatingRing-v4'"),
    ],
)
def test_a_changed_study_never_mixes_with_the_former_ones_results(copied, changes, word, capsys):
    write_study(copied, **changes)
    before = contents(copied / "results")
    assert main(command(copied)) == 2
    said = capsys.readouterr().err
    assert contents(copied / "results") == before
    with pytest.raises(ValueError, match=word):
        raise ValueError(said)


def test_a_gate_of_another_run_or_recording_is_refused(copied, capsys):
    folder = copied / "results" / "gates" / "ring" / "A_independent-150"
    first, second = (folder / f"seed-{seed}" / "000150-frozen.gate.json.gz" for seed in (0, 1))
    shutil.copy(first, second)
    assert main(command(copied, "--verdict-only")) == 2
    assert "training seed 0, expected 1" in capsys.readouterr().err
    gate = read_gate(first)
    changed = json.loads(json.dumps(gate.provenance))
    changed["training"]["seed"] = 1
    changed["dataset"]["fingerprint"] = "0" * 64
    write_gate(replace(gate, provenance=changed), second, overwrite=True)
    assert main(command(copied, "--verdict-only")) == 2
    assert "expected one recording of ring" in capsys.readouterr().err
    for mechanism, value in (("token", "oracle"), ("latent", "prior")):
        other = json.loads(json.dumps(gate.provenance))
        other["training"]["seed"] = 1
        other["config"][mechanism] = value
        write_gate(replace(gate, provenance=other), second, overwrite=True)
        assert main(command(copied, "--verdict-only")) == 2
        assert f"policy.{mechanism} '{value}', expected None" in capsys.readouterr().err
    # Another training split and other states: another recording, not another processor's.
    changed["run"]["training_data"] = "0" * 64
    write_gate(replace(gate, provenance=changed, conditions=gate.conditions + 0.01), second, overwrite=True)
    assert main(command(copied, "--verdict-only")) == 2
    assert "expected one recording of ring" in capsys.readouterr().err


def test_demonstrations_recorded_on_another_processor_are_the_same_demonstrations(copied, capsys):
    path = copied / "results" / "gates" / "ring" / "A_independent-150" / "seed-1" / "000150-frozen.gate.json.gz"
    gate = read_gate(path)
    gate.provenance["dataset"]["fingerprint"] = gate.provenance["run"]["training_data"] = "0" * 64
    last_bits = gate.conditions * (1 + 1e-12)
    write_gate(replace(gate, conditions=last_bits), path, overwrite=True)
    assert main(command(copied, "--verdict-only")) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "16 of 16" in said
    assert "ring: the same demonstrations recorded on 2 kinds of processor" in said


def test_a_gate_from_another_machine_is_taken_by_what_it_holds(copied, capsys):
    path = copied / "results" / "gates" / "ring" / "A_independent-150" / "seed-0" / "000150-frozen.gate.json.gz"
    gate = read_gate(path)
    gate.provenance["run"] |= {"device": "cuda", "precision": "bf16"}
    gate.provenance["training"]["device"] = "cuda"
    # A field that the policy has gained since is what it was before.
    gate.provenance["config"].pop("token_positions")
    gate.provenance["config"].pop("embedding_gain")
    write_gate(gate, path, overwrite=True)
    assert main(command(copied, "--verdict-only")) == 0
    assert "16 of 16" in capsys.readouterr().out
    assert "bf16,cuda" in (copied / "results" / "small" / "table.csv").read_text()


def test_a_gate_older_than_the_embeddings_gain_has_a_gain_of_one(copied, capsys):
    path = copied / "results" / "gates" / "ring" / "A_independent-150" / "seed-0" / "000150-frozen.gate.json.gz"
    gate = read_gate(path)
    gate.provenance["config"].pop("embedding_gain")
    write_gate(gate, path, overwrite=True)
    study = write_study(copied, flags=STUDY["flags"] | {"policy.embedding_gain": 8.0})
    assert main(command(copied, "--verdict-only", study=study)) == 2
    assert "policy.embedding_gain 1.0, expected 8.0" in capsys.readouterr().err


def test_the_store_reads_what_the_plan_asked_for(finished):
    plan = plan_study(read_study(finished / "small.yaml"))
    results = GateStore(finished / "results" / "gates").results(plan)
    assert [(r.dataset, r.configuration, r.seed, r.step, r.bank) for r in results] == [
        (e.run.dataset, e.run.configuration, e.run.seed, e.step, e.bank) for e in plan.evaluations
    ]


def test_an_unknown_study_is_refused_with_the_ones_there_are(capsys):
    assert main(["study", "astrology"]) == 2
    assert "there is no study 'astrology'" in capsys.readouterr().err


def _gates(folder: Path):
    return (folder / "results" / "gates").rglob("*.gate.json.gz")
