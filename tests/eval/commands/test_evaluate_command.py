"""`dualhead evaluate`: a policy, the exact reference or recorded rollouts to a gate file."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file, save_file

from dualhead_eval.cli import main
from dualhead_eval.gate.file import read_gate
from dualhead_eval.statistics.training_record import training_record
from dualhead_policy.pretrained import policy_folder

LIGHT = ("torch", "lerobot", "mujoco", "matplotlib")


def test_a_policy_becomes_a_gate_whose_every_sample_is_counted(trained, ring_data, tmp_path, capsys):
    output = tmp_path / "run.gate.json"
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--output", str(output)]
    assert main([*arguments, "--pairs", "8", "--nfe", "20", "5", "--tau", "0.4"]) == 0
    gate = read_gate(output)
    assert gate.counts.shape == (2, 2, 12, 3, 3)
    assert (gate.counts.sum(axis=(-1, -2)) == 8).all()
    assert (gate.reference_nfe, gate.reference_tau, gate.nfes) == (20, 0.55, [5, 20])
    assert gate.provenance["training_step"] == 30
    assert gate.provenance["config"]["token"] == "oracle"
    assert "run" in capsys.readouterr().out
    assert main([*arguments, "--pairs", "8"]) == 2
    assert "add --overwrite" in capsys.readouterr().err


def test_the_exact_reference_is_evaluated_like_a_policy_and_repeats(ring_data, tmp_path):
    gates = []
    for name in ("a", "b"):
        output = tmp_path / f"{name}.json"
        arguments = ["evaluate", "--exact", "--dataset", str(ring_data / "test"), "--output", str(output)]
        assert main([*arguments, "--pairs", "64", "--label", "exact"]) == 0
        gates.append(read_gate(output))
    assert (gates[0].counts == gates[1].counts).all()
    assert gates[0].provenance["method"] == "exact reference"
    assert list(gates[0].target_probabilities) == [0.5, 0.5]


def test_recorded_rollouts_are_a_lerobot_dataset_that_evaluates_to_the_same_gate(trained, ring_data, tmp_path):
    from lerobot.datasets import LeRobotDataset

    output = tmp_path / "loop.json"
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--output", str(output)]
    assert main([*arguments, "--record", str(tmp_path / "rollouts"), "--episodes", "3", "--samples", "4"]) == 0
    dataset = LeRobotDataset("local/rollouts", root=tmp_path / "rollouts", video_backend="pyav")
    assert dataset.num_episodes == 3
    frame = dataset[0]
    assert frame["prediction.decision"].item()
    assert frame["prediction.joint"].shape == (4 * 16 * 6,)
    # The executed action is the first sampled chunk's first step, in both representations.
    assert np.allclose(frame["action"][:6], frame["prediction.joint"][:6])
    assert np.allclose(frame["action"][6:], frame["prediction.position"][:2])
    again = tmp_path / "again.json"
    assert main(["evaluate", "--rollouts", str(tmp_path / "rollouts"), "--output", str(again)]) == 0
    assert (read_gate(output).counts == read_gate(again).counts).all()
    # The oracle token is held through the episode: the pair that follows it is no draw of its decision.
    assert read_gate(again).counts.sum() == 3 * (4 - 1)


def test_many_policies_become_the_gates_of_evaluating_each_alone(trained, ring_data, tmp_path, capsys):
    runs = [shutil.copytree(policy_folder(trained), tmp_path / "runs" / name) for name in ("first", "second")]
    # The second stands for another seed of the same setting.
    weights = {
        name: 1.01 * value for name, value in load_file(runs[1] / "model.safetensors").items() if "output" in name
    }
    save_file(load_file(runs[1] / "model.safetensors") | weights, runs[1] / "model.safetensors")
    for name in ("config.json", "train_config.json"):
        content = json.loads((runs[1] / name).read_text())
        (runs[1] / name).write_text(json.dumps(content | {"seed": 1001}))
    common = ["--dataset", str(ring_data / "test"), "--pairs", "16"]
    arguments = ["evaluate", *common, "--policy", *map(str, runs), "--output", str(tmp_path / "gates")]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "first" in shown
    assert "second" in shown
    assert main(["evaluate", *common, "--policy", str(runs[1]), "--output", str(tmp_path / "second.gate.json")]) == 0
    alone, among = tmp_path / "second.gate.json", tmp_path / "gates" / "second.gate.json"
    assert alone.read_text() == among.read_text()
    # What an interrupted command finished is kept; what another protocol would replace is refused.
    written = among.stat().st_mtime_ns
    (tmp_path / "gates" / "first.gate.json").unlink()
    assert main(arguments) == 0
    assert among.stat().st_mtime_ns == written
    capsys.readouterr()
    assert main([*arguments, "--seed", "1"]) == 2
    assert "holds another evaluation" in capsys.readouterr().err
    assert main([*arguments, "--update-card"]) == 2
    assert "is for one policy, 2 are given" in capsys.readouterr().err
    assert main([*arguments, "--policy", str(runs[0])]) == 2
    assert "two policies are called 'first'" in capsys.readouterr().err
    copied = shutil.copytree(runs[0], tmp_path / "runs" / "copied")
    assert main([*arguments, "--policy", str(copied)]) == 2
    assert "hold the same checkpoint" in capsys.readouterr().err


def test_protocol_numbers_reach_the_policys_card(trained, ring_data, tmp_path):
    folder = shutil.copytree(policy_folder(trained), tmp_path / "policy")
    arguments = ["evaluate", "--policy", str(folder), "--dataset", str(ring_data / "test"), "--pairs", "8"]
    before = (folder / "README.md").read_text()
    assert main([*arguments, "--output", str(tmp_path / "a.gate.json"), "--update-card"]) == 0
    card, gate = (folder / "README.md").read_text(), read_gate(tmp_path / "a.gate.json")
    rate = (gate.pair_table()[:, :2, :2].sum() / gate.pair_table().sum()).item()
    assert f"| valid-pair rate | {rate:.4g} |" in card
    assert "| sample pairs per condition | 8 |" in card
    assert f"| training loss | {training_record(gate).loss} |" in card
    assert set(before.splitlines()) <= set(card.splitlines())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--policy", "nowhere", "--dataset", "{data}/test"], "holds no policy"),
        (["--exact", "--dataset", "{data}"], "name one of its splits"),
        (["--exact", "--dataset", "nowhere"], "is not a LeRobotDataset"),
        (["--exact"], "--dataset is missing"),
        (["--exact", "--dataset", "{data}/test", "--pairs", "0"], "not positive"),
        (["--exact", "--dataset", "{data}/test", "--nfe", "5", "5"], "different numbers of steps"),
        (["--exact", "--dataset", "{data}/test", "--tau", "nan"], "finite thresholds"),
        (["--exact", "--dataset", "{data}/test", "--conditions", "13"], "holds 12 conditions"),
        (["--exact", "--dataset", "{data}/test", "--control", "pose"], "give --record instead"),
        (["--rollouts", "{data}/test", "--nfe", "5"], "give --policy or --pair or --exact instead"),
        (["--exact", "--dataset", "{data}/test", "--source-noise-beta", "2"], "outside"),
        (["--rollouts", "{data}/test"], "not a dataset of recorded rollouts"),
        (["--exact", "--dataset", "{data}/test", "--record", "x"], "give --policy too"),
        (["--exact", "--dataset", "{data}/test", "--update-card"], "has no meaning with --exact"),
    ],
)
def test_what_cannot_be_evaluated_is_refused_in_one_line(arguments, sentence, ring_data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = [argument.format(data=ring_data) for argument in arguments]
    assert main(["evaluate", *given, "--output", "gate.json"]) == 2
    error = capsys.readouterr().err.strip()
    assert sentence in error
    assert error.count("\n") == 0
    assert not Path("gate.json").exists()


@pytest.mark.parametrize("arguments", [[], ["record"], ["train"], ["evaluate"], ["report"], ["demo"]])
def test_help_imports_nothing_heavy(arguments):
    code = (
        "import sys\nfrom dualhead_eval.cli import main\n"
        f"try:\n    main({[*arguments, '--help']!r})\nexcept SystemExit as done:\n    assert done.code == 0\n"
        f"print('LOADED', [name for name in {LIGHT!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "LOADED []" in done.stdout
    assert "usage: dualhead" in done.stdout
