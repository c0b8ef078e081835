"""Three ways past the wall, from demonstrations to a report: every stage counts as many modes as there are."""

import json

import numpy as np
import pytest
import torch

from dualhead_envs.bypass.record import record_bypass
from dualhead_envs.dataset_frames import read_split
from dualhead_eval.cli import main
from dualhead_eval.effects import coordination
from dualhead_eval.effects.counts import joint_table
from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.evaluation.rollouts import read_closed_loop
from dualhead_eval.gate import read_gate
from dualhead_eval.report.content import make_report
from dualhead_eval.report.tables import closed_loop_modes_table
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.pretrained import load_policy
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "three"
    return record_bypass("BimodalBypass-v2", root, pairs=5, env_kwargs={"ways": 3}, workers=1, progress=False)


@pytest.fixture(scope="module")
def oracle(data, tmp_path_factory):
    output = tmp_path_factory.mktemp("runs") / "oracle"
    flags = [f"--dataset.root={data / 'train'}", f"--output_dir={output}", "--policy.token=oracle"]
    flags += ["--steps=3", "--batch_size=16", "--policy.velocity_width=32", "--policy.device=cpu"]
    Training(parse_training_config(flags, None)).run()
    return output


def test_an_oracle_has_a_token_for_every_way(oracle):
    policy, _ = load_policy(oracle)
    assert policy.config.n_tokens == 3
    assert policy.model.tokens.marginal.tolist() == pytest.approx([1 / 3] * 3)


def test_the_demonstrations_themselves_coordinate_in_full_among_three_modes(data):
    conditions = open_conditions(data / "test")
    assert conditions.partition.n_modes == 3
    frames = read_split(data / "test")
    joint = frames.mode_windows(16, "joint.")
    position = frames.mode_windows(16)
    through = KinematicMap("panda").position(torch.from_numpy(joint)).numpy()
    np.testing.assert_allclose(through, position, atol=2e-4)
    labels = [conditions.partition.assign(head, np.zeros(18)) for head in (through, position)]
    table = joint_table(labels, 3)
    assert table.sum(axis=0).tolist() == np.diag([len(conditions)] * 3 + [0]).tolist()
    assert coordination(table[:, :3, :3]).rho == pytest.approx(1.0)


def test_gate_files_and_rollouts_count_three_modes(oracle, data, tmp_path, capsys):
    gate_file, loop_file, rollouts = (tmp_path / name for name in ("K.gate.json", "loop.gate.json", "rollouts"))
    arguments = ["evaluate", "--policy", str(oracle), "--dataset", str(data / "test")]
    assert main([*arguments, "--pairs", "8", "--output", str(gate_file)]) == 0
    gate = read_gate(gate_file)
    assert gate.n_modes == 3
    assert gate.counts.shape[-2:] == (4, 4)
    assert gate.provenance["partition"]["name"] == "bypass-v2-three-ways"

    driven = [*arguments, "--record", str(rollouts), "--episodes", "1", "--control", "position"]
    assert main([*driven, "--output", str(loop_file)]) == 0
    assert read_gate(loop_file).n_modes == 3
    sidecar = json.loads((rollouts / "meta" / "dualhead.json").read_text())
    assert sidecar["env_kwargs"]["ways"] == 3
    capsys.readouterr()
    assert main(["report", str(gate_file), str(rollouts)]) == 0
    shown = capsys.readouterr().out
    assert "K = 3" in shown
    assert "Closed loop, mode by mode" in shown
    assert "paper's row" not in shown, "the paper has no third way"


def test_success_is_told_way_by_way_with_wilsons_interval(oracle, data, tmp_path):
    outcomes = [
        {"seed": 0, "success": True, "collision": False, "mode": 0},
        {"seed": 1, "success": True, "collision": False, "mode": 2},
        {"seed": 2, "success": False, "collision": True, "mode": 2},
        {"seed": 3, "success": False, "collision": True, "mode": -1},
    ]
    conditions = open_conditions(data / "test")
    sidecar = {
        "format": "dualhead-rollouts/1", "layout": "panda", "env_id": "BimodalBypass-v2",
        "env_kwargs": {"ways": 3, "control": "joint"}, "horizon": 16, "samples": 2, "num_inference_steps": 20,
        "seed": 0, "partition": conditions.partition.to_dict(), "outcomes": outcomes,
    }  # fmt: skip
    path = tmp_path / "K.rollouts.json"
    path.write_text(json.dumps(sidecar))
    name, loop = read_closed_loop(path)
    assert [(o.mode, o.episodes, o.successes) for o in loop.modes] == [(0, 1, 1), (1, 0, 0), (2, 2, 1), (-1, 1, 0)]
    assert (loop.modes[1].success_interval.low, loop.modes[1].success_interval.high) == (0, 1)
    table = closed_loop_modes_table(make_report([], [(name, loop)]))
    assert [row[2] for row in table.rows] == ["0", "1", "2", "none"]
    assert table.rows[2][4].startswith("50.0% [15.0,85.0]")
    assert table.rows[1][5] == "undefined"
