"""A sweep trains every run once, as `dualhead train` would, and goes on after an interruption."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml
from safetensors.torch import load_file

from dualhead_eval.cli import main
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.checkpoints import last_checkpoint, last_step, staged
from dualhead_policy.training.sweep.group_commit import Commit, publish_group
from dualhead_policy.training.sweep.group_training import Group, train_group
from dualhead_policy.training.sweep.grouping import make_groups, plan_runs, run_identity
from dualhead_policy.training.sweep.manifest import continue_manifest, read_manifest
from dualhead_policy.training.sweep.sweep_file import expand, read_sweep
from dualhead_policy.training.trainer import Training

FLAGS = {
    "steps": 12, "save_freq": 4, "batch_size": 16, "policy.device": "cpu", "policy.velocity_width": 16,
    "policy.encoder_dim": 16,
}  # fmt: skip


def sweep_file(folder: Path, ring_data: Path, **changes) -> Path:
    content = {
        "output": str(folder / "sweep"),
        "datasets": {"ring": str(ring_data / "train")},
        "configurations": [
            {"name": "lambda-1", "flags": {"policy.consistency_weight": 1}},
            {"name": "lambda-3", "flags": {"policy.consistency_weight": 3}},
            {"name": "oracle", "flags": {"policy.token": "oracle"}},
        ],
        "seeds": [0, 1],
        "flags": FLAGS,
    }
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump(content | changes))
    return path


def planned(path: Path):
    sweep = read_sweep(path)
    return plan_runs(expand(sweep), Path(sweep.output))


def weights(folder: Path):
    return load_file(last_checkpoint(folder) / "pretrained_model" / "model.safetensors")


def group_of(path: Path, output: Path, *names: str) -> Group:
    runs = [run.run for run in planned(path) if run.run.name in names]
    return Group("group-000", output, tuple(runs), "fp32", None)


def test_runs_of_one_shape_train_as_one_program(ring_data, tmp_path):
    groups = make_groups(planned(sweep_file(tmp_path, ring_data)), size=16, jobs=1)
    assert [[run.run.name for run in group] for group in groups] == [
        [f"ring/{name}/seed-{seed}" for name in ("lambda-1", "lambda-3") for seed in (0, 1)],
        ["ring/oracle/seed-0", "ring/oracle/seed-1"],
    ]


def test_a_group_fills_the_workers_and_no_more_than_its_size(ring_data, tmp_path):
    runs = planned(sweep_file(tmp_path, ring_data, configurations=[{"name": "A"}], seeds=list(range(10))))
    assert [len(group) for group in make_groups(runs, size=4, jobs=1)] == [4, 4, 2]
    assert [len(group) for group in make_groups(runs, size=16, jobs=2)] == [5, 5]


def test_every_run_is_what_train_leaves_and_the_same_sweep_gives_the_same_bytes(ring_data, tmp_path):
    path = sweep_file(tmp_path, ring_data)
    names = ["ring/lambda-1/seed-0", "ring/lambda-3/seed-1"]
    for attempt in ("once", "again"):
        outcome = train_group(group_of(path, tmp_path / attempt, *names))
        assert {name: ended["state"] for name, ended in outcome.items()} == dict.fromkeys(names, "finished")
    for name in names:
        once = last_checkpoint(tmp_path / "once" / name) / "pretrained_model" / "model.safetensors"
        again = last_checkpoint(tmp_path / "again" / name) / "pretrained_model" / "model.safetensors"
        assert once.read_bytes() == again.read_bytes()
    run = next(run.run for run in planned(path) if run.run.name == names[1])
    alone = Training(parse_training_config([*run.arguments, f"--output_dir={tmp_path / 'alone'}"], None))
    alone.run()
    together, single = weights(tmp_path / "once" / names[1]), weights(tmp_path / "alone")
    for name, value in single.items():
        torch.testing.assert_close(together[name], value, rtol=1e-5, atol=1e-7)
    log = [json.loads(line) for line in (tmp_path / "once" / names[1] / "training_log.jsonl").read_text().splitlines()]
    own = [json.loads(line) for line in (tmp_path / "alone" / "training_log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in log] == [line["step"] for line in own] == [4, 8, 12]
    assert [line["loss"] for line in log] == pytest.approx([line["loss"] for line in own], rel=1e-5)


def test_a_sweep_goes_on_from_its_checkpoints_to_the_same_weights(ring_data, tmp_path):
    path, names = sweep_file(tmp_path, ring_data), ["ring/oracle/seed-0", "ring/oracle/seed-1"]
    train_group(group_of(path, tmp_path / "whole", *names))
    cut = group_of(path, tmp_path / "cut", *names)
    train_group(cut)
    for name in names:
        checkpoints = tmp_path / "cut" / name / "checkpoints"
        (checkpoints / "last").unlink()
        (checkpoints / "last").symlink_to("000004")
    train_group(cut)
    for name in names:
        whole, resumed = weights(tmp_path / "whole" / name), weights(tmp_path / "cut" / name)
        assert all(torch.equal(whole[key], resumed[key]) for key in whole)


def test_a_run_that_was_copied_without_its_links_is_named(tmp_path):
    (tmp_path / "checkpoints" / "last").mkdir(parents=True)
    with pytest.raises(ValueError, match=r"last is a folder, expected a link to a checkpoint: .* `cp -a`"):
        last_step(tmp_path)


def test_a_group_saves_where_any_of_its_runs_wants_to(ring_data, tmp_path):
    names = ["ring/oracle/seed-0", "ring/oracle/seed-1"]
    group = group_of(sweep_file(tmp_path, ring_data), tmp_path / "out", *names)
    first, second = group.runs
    train_group(replace(group, runs=(first, replace(second, save_at=(3,)))))
    saved = [sorted(path.name for path in (tmp_path / "out" / name / "checkpoints").iterdir()) for name in names]
    assert saved[0] == saved[1]
    assert "000003" in saved[0]


def test_a_kill_between_staging_and_publishing_leaves_checkpoints_of_one_step(tmp_path):
    commit_file = tmp_path / ".groups" / "group-000.commit.json"
    places = [tmp_path / run / "checkpoints" / "000008" for run in ("a", "b")]
    for place in places:
        staged(place).mkdir(parents=True)
        (staged(place) / "state").write_text("8")
    commit_file.parent.mkdir()
    names = [str(place.relative_to(tmp_path)) for place in places]
    commit_file.write_text(Commit(checkpoints=names).model_dump_json())
    staged(places[0]).rename(places[0])  # the first had been published when the kill came
    publish_group(tmp_path, commit_file)
    assert [last_checkpoint(tmp_path / run).name for run in ("a", "b")] == ["000008", "000008"]
    assert not commit_file.exists()


def test_another_configuration_under_the_same_name_is_refused(ring_data, tmp_path):
    manifest = continue_manifest(None, planned(sweep_file(tmp_path, ring_data)), size=16, jobs=1)
    other = planned(sweep_file(tmp_path, ring_data, flags=FLAGS | {"policy.optimizer_lr": 1e-4}))
    with pytest.raises(ValueError, match="run ring/lambda-1/seed-0 was begun with another configuration"):
        continue_manifest(manifest, other, size=16, jobs=1)


def test_a_run_is_its_precision_but_not_its_device(ring_data, tmp_path):
    path = sweep_file(tmp_path, ring_data)
    sweep = read_sweep(path)
    runs = expand(sweep)
    fp32, bf16 = (plan_runs(runs, tmp_path / "out", precision) for precision in ("fp32", "bf16"))
    assert not {run.fingerprint for run in fp32} & {run.fingerprint for run in bf16}
    assert [run.stacking_key for run in fp32] == [run.stacking_key for run in bf16]
    training = {"steps": 12, "policy": {"device": "cpu", "token": None}}
    elsewhere = training | {"policy": {"device": "cuda", "token": None}}
    other = training | {"policy": {"device": "cpu", "token": "oracle"}}
    here = run_identity(training, "data", False, "fp32")
    assert run_identity(elsewhere, "data", False, "fp32") == here
    assert run_identity(other, "data", False, "fp32") != here


def test_more_seeds_join_in_groups_of_their_own(ring_data, tmp_path):
    manifest = continue_manifest(None, planned(sweep_file(tmp_path, ring_data)), size=16, jobs=1)
    more = continue_manifest(manifest, planned(sweep_file(tmp_path, ring_data, seeds=[0, 1, 2])), size=16, jobs=1)
    assert {name: more.runs[name].group for name in manifest.runs} == {
        name: record.group for name, record in manifest.runs.items()
    }
    assert more.runs["ring/oracle/seed-2"].group not in manifest.groups()


def test_a_run_that_fails_leaves_the_others_alone(ring_data, tmp_path):
    steep = {"name": "steep", "flags": {"policy.consistency_weight": 1, "policy.optimizer_lr": 1e30}}
    calm = {"name": "calm", "flags": {"policy.consistency_weight": 1}}
    path = sweep_file(tmp_path, ring_data, configurations=[calm, steep], seeds=[0])
    outcome = train_group(group_of(path, tmp_path / "sweep", "ring/calm/seed-0", "ring/steep/seed-0"))
    assert outcome["ring/calm/seed-0"]["state"] == "finished"
    assert "the loss is not a number" in outcome["ring/steep/seed-0"]["error"]


def test_a_group_that_does_not_fit_into_memory_is_split_aloud(ring_data, tmp_path, monkeypatch, capsys):
    from dualhead_policy.training.stacked import stacked_training

    begin = stacked_training.StackedModel.__init__

    def only_one_fits(self, models, precision):
        if len(models) > 1:
            raise torch.OutOfMemoryError("out of memory")
        begin(self, models, precision)

    monkeypatch.setattr(stacked_training.StackedModel, "__init__", only_one_fits)
    names = ["ring/lambda-1/seed-0", "ring/lambda-1/seed-1"]
    outcome = train_group(group_of(sweep_file(tmp_path, ring_data), tmp_path / "sweep", *names))
    assert [outcome[name]["state"] for name in names] == ["finished", "finished"]
    assert "2 runs do not fit into memory together, training 1 and then 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"seeds": [0, 0]}, "has the run ring/lambda-1/seed-0 twice"),
        ({"datasets": {"ring": "nowhere"}}, "dataset ring of the sweep, nowhere, is not a LeRobotDataset"),
        ({"configurations": ["nowhere.yaml"]}, "configuration nowhere.yaml of the sweep does not exist"),
        ({"colour": "red"}, "has an unknown field 'colour'"),
        ({"configurations": [{"name": "a"}, {"name": "b", "flags": {"policy.colour": 1}}]}, "configuration ring/b"),
        ({"flags": {"seed": 3}}, "which the sweep sets itself"),
        ({"seeds": []}, "seeds"),
    ],
)
def test_a_wrong_sweep_is_refused_in_one_sentence_and_trains_nothing(ring_data, tmp_path, capsys, changes, sentence):
    assert main(["sweep", str(sweep_file(tmp_path, ring_data, **changes)), "--no-progress"]) == 2
    message = capsys.readouterr().err
    assert sentence in message
    assert len(message.strip().splitlines()) == 1
    assert not (tmp_path / "sweep").exists()


def test_the_command_trains_reports_what_is_missing_and_then_does_nothing_more(ring_data, tmp_path, capsys):
    path = sweep_file(tmp_path, ring_data, configurations=[{"name": "A"}], seeds=[0])
    assert main(["sweep", str(path), "--no-progress", "--jobs", "1"]) == 0
    model = last_checkpoint(tmp_path / "sweep" / "ring" / "A" / "seed-0") / "pretrained_model" / "model.safetensors"
    written = model.stat().st_mtime_ns
    more = sweep_file(tmp_path, ring_data, configurations=[{"name": "A"}], seeds=[0, 1])
    manifest = continue_manifest(read_manifest(tmp_path / "sweep"), planned(more), size=16, jobs=1)
    manifest.write(tmp_path / "sweep")
    capsys.readouterr()
    assert main(["report", str(tmp_path / "sweep")]) == 0
    said = capsys.readouterr().out
    assert "1 of 2 runs finished" in said
    assert "missing ring/A/seed-1: at step 0 of 12" in said
    assert main(["sweep", str(path), "--no-progress", "--jobs", "1"]) == 0
    assert model.stat().st_mtime_ns == written
