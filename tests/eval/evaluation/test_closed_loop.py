"""Closed-loop outcomes: counted from rollouts, read back, shown with Wilson's interval."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys

import numpy as np
import pytest
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies.factory import make_policy

from dualhead_envs.dataset_sidecar import read_rollout_sidecar
from dualhead_eval.cli import main
from dualhead_eval.evaluation.closed_loop import record_rollouts
from dualhead_eval.evaluation.decisions import held_pairs
from dualhead_eval.evaluation.rollouts import ClosedLoop, read_closed_loop, rollout_gate
from dualhead_eval.gate import read_gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.pretrained import load_policy
from dualhead_policy.processor_dualhead import make_dualhead_pre_post_processors

SMALL = {"velocity_width": 16, "encoder_dim": 8, "seed": 0, "device": "cpu"}


def sidecar(successes, failures, *, control="joint", **more):
    outcomes = [
        {"seed": i, "success": i < successes, "collision": False, "mode": 0} for i in range(successes + failures)
    ]
    return {
        "format": "dualhead-rollouts/1",
        "env_id": "BimodalBypass-v2",
        "env_kwargs": {"control": control},
        "layout": "panda",
        "horizon": 16,
        "samples": 2,
        "num_inference_steps": 20,
        "seed": 0,
        "partition": {"name": "bypass-v2", "n_modes": 2, "tau": 0.11, "parameters": {}},
        "outcomes": outcomes,
        **more,
    }


@pytest.mark.parametrize(("successes", "episodes"), [(0, 10), (7, 10), (150, 150), (131, 150)])
def test_the_interval_is_wilsons(successes, episodes):
    interval = ClosedLoop("BimodalBypass-v2", "joint", episodes, successes, 0).success_interval
    # The roots of (share - p)^2 = z^2 p (1 - p) / n.
    z2, share = 1.959963984540054**2, successes / episodes
    roots = np.roots([1 + z2 / episodes, -2 * share - z2 / episodes, share**2])
    assert (interval.low, interval.high) == pytest.approx(sorted(roots.real), abs=1e-6)


def test_a_copy_of_the_outcomes_is_reported_like_the_rollouts(tmp_path, capsys):
    (tmp_path / "rollouts" / "meta").mkdir(parents=True)
    text = json.dumps(sidecar(9, 1, control="position", policy={"training_step": 50_000}))
    (tmp_path / "rollouts" / "meta" / "dualhead.json").write_text(text)
    (tmp_path / "oracle.rollouts.json").write_text(text)
    (tmp_path / "packed.rollouts.json.gz").write_bytes(gzip.compress(text.encode()))
    copies = [read_closed_loop(tmp_path / name) for name in ("oracle.rollouts.json", "packed.rollouts.json.gz")]
    assert [outcome for _, outcome in copies] == [read_closed_loop(tmp_path / "rollouts")[1]] * 2
    assert [name for name, _ in copies] == ["oracle, 50000 steps", "packed, 50000 steps"]
    assert main(["report", str(tmp_path / "rollouts"), str(tmp_path / "oracle.rollouts.json")]) == 0
    shown = capsys.readouterr().out
    # Each of the two in the table of all episodes, and in that of the one mode which all of them are of.
    assert shown.count("90.0% [59.6,98.2]") == 4
    assert "oracle, 50000 steps" in shown


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"outcomes": []}, "outcomes"),
        ({"outcomes": [{"seed": 0, "success": "yes", "collision": False, "mode": 0}]}, r"outcomes\.0\.success = 'yes'"),
        ({"outcomes": [{"seed": 0, "success": True, "collision": True, "mode": 0}]}, "both success and collision"),
        ({"outcomes": [{"seed": 0, "success": True, "collision": False, "mode": 0}] * 2}, "seed twice"),
        ({"env_kwargs": {}}, r"env_kwargs\.control"),
        ({"env_id": "os:system"}, "names no environment"),
        ({"samples": 0}, "samples = 0"),
        ({"format": "dualhead-dataset/1"}, "dualhead-rollouts/1"),
        ({"colour": "red"}, "unknown field 'colour'"),
    ],
)
def test_outcomes_that_cannot_be_are_refused(tmp_path, change, sentence):
    path = tmp_path / "run.rollouts.json"
    path.write_text(json.dumps(sidecar(3, 1) | change))
    with pytest.raises(ValueError, match=sentence):
        read_closed_loop(path)


def test_two_processes_do_not_record_into_one_folder(trained, ring_data, tmp_path, capsys):
    target = tmp_path / "rollouts"
    partial = tmp_path / ".rollouts.partial"
    (partial / "work" / "dataset" / "meta").mkdir(parents=True)  # left by a kill
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--record", str(target)]
    arguments += ["--episodes", "1", "--output", str(tmp_path / "loop.gate.json")]
    hold = (
        "import pathlib, sys\nfrom dualhead_envs.recording.staging import staging_folder\n"
        "with staging_folder(pathlib.Path(sys.argv[1])):\n    print(flush=True)\n    input()"
    )
    command = [sys.executable, "-c", hold, str(target)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        assert main(arguments) == 2
        other.stdin.write(b"\n")
    assert "another process" in capsys.readouterr().err
    assert main(arguments) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"rollouts", "loop.gate.json"}


def test_a_closed_loop_is_recorded_with_the_noise_that_is_asked_for(trained, ring_data, tmp_path, capsys):
    """A recording and its gate say under which coupling of the heads' noise they were made."""
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--episodes", "2"]
    aligned = ["--source-noise-beta", "0", "--source-noise-alignment", "kinematic"]
    gates, recorded = {}, {}
    for name, more in {"own": [], "aligned": aligned}.items():
        gate, target = tmp_path / f"{name}.gate.json", tmp_path / name
        assert main([*arguments, "--record", str(target), "--output", str(gate), "--samples", "3", *more]) == 0
        gates[name], recorded[name] = (
            mechanism_of(read_gate(gate)),
            read_rollout_sidecar(target / "meta" / "dualhead.json"),
        )
    assert "coupling" not in recorded["own"]["policy"]
    assert recorded["aligned"]["policy"]["coupling"]["source_noise_alignment"] == "kinematic"
    assert [(one.beta, one.alignment) for one in gates.values()] == [(1.0, None), (0.0, "kinematic")]
    capsys.readouterr()
    for more, sentence in (
        (["--source-noise-alignment", "kinematic"], "source_noise_beta=1 shares none: give source_noise_beta=0 too"),
        (["--source-noise-beta", "1.5"], "source_noise_beta=1.5 is outside [0, 1]"),
    ):
        target = tmp_path / "refused"
        refused = [*arguments, "--record", str(target), "--output", str(tmp_path / "refused.gate.json")]
        assert main([*refused, *more]) == 2
        assert sentence in capsys.readouterr().err
        assert not target.exists()


def test_a_pose_is_executed_where_the_policy_has_an_orientation_head(panda_data, trained, ring_data, tmp_path, capsys):
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    arguments = ["--output", str(tmp_path / "gate.json"), "--record", str(tmp_path / "rollouts"), "--control", "pose"]
    arguments += ["--episodes", "1", "--perturb", "noise:0.01", "--dataset", str(panda_data / "test")]
    for rotation_head, status in ((False, 2), (True, 0)):
        config = DualheadConfig(rotation_head=rotation_head, **SMALL)
        folder = tmp_path / f"policy-{rotation_head}"
        policy = make_policy(config, ds_meta=meta)
        policy.save_pretrained(folder)
        for processor in make_dualhead_pre_post_processors(policy.config, dataset_stats=meta.stats):
            processor.save_pretrained(folder)
        assert main(["evaluate", "--policy", str(folder), *arguments]) == status
    assert "executes the orientation head, which this policy lacks" in capsys.readouterr().err
    assert read_closed_loop(tmp_path / "rollouts")[1].control == "pose"
    kept = json.loads((tmp_path / "rollouts" / "meta" / "dualhead.json").read_text())
    assert kept["env_kwargs"]["perturbation"] == "noise:0.01"
    assert kept["outcomes"][0]["failure"] in ("collision", "drop", "miss", "timeout")
    assert kept["outcomes"][0]["onset"] == 0
    unperturbed = [argument for argument in arguments if argument not in ("--perturb", "noise:0.01")]
    assert main(["evaluate", "--policy", str(trained), *unperturbed[:-1], str(ring_data / "test"), "--overwrite"]) == 2
    assert "lacks" in capsys.readouterr().err


def test_only_the_robot_is_perturbed(trained, ring_data, tmp_path, capsys):
    arguments = [
        "--output",
        str(tmp_path / "gate.json"),
        "--record",
        str(tmp_path / "rollouts"),
        "--perturb",
        "noise:0.01",
    ]
    assert main(["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), *arguments]) == 2
    assert "only the robot environments are perturbed" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_what_is_no_outcome_is_refused(tmp_path, capsys):
    assert main(["report", str(tmp_path / "gone.rollouts.json")]) == 2
    assert "does not exist" in capsys.readouterr().err
    for name, text in {"cut": '{"format": ', "foreign": '{"format": "x/1"}', "list": "[]"}.items():
        path = tmp_path / f"{name}.rollouts.json"
        path.write_text(text)
        assert main(["report", str(path)]) == 2
        error = capsys.readouterr().err.strip()
        assert error.count("\n") == 0
        assert "again" in error or "--record" in error


def test_a_rolled_out_policy_keeps_what_became_of_its_episodes(trained, ring_data, tmp_path, capsys):
    target = tmp_path / "rollouts"
    arguments = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--record", str(target)]
    assert main([*arguments, "--episodes", "3", "--output", str(tmp_path / "loop.gate.json")]) == 0
    assert "joint head driving: success" in capsys.readouterr().out
    kept = json.loads((target / "meta" / "dualhead.json").read_text())
    assert [outcome["seed"] for outcome in kept["outcomes"]] == [0, 1, 2]
    assert kept["policy"]["training_step"] == 30
    name, loop = read_closed_loop(target)
    assert (name, loop.episodes) == ("rollouts, 30 steps", 3)
    assert loop.successes == sum(outcome["success"] for outcome in kept["outcomes"])


def faulty(preprocess, seeds):
    """A preprocessor whose sensor fails (NaN) in the first decision of some episodes."""
    decisions = iter(range(1000))

    def observe(raw):
        batch = preprocess(raw)
        if next(decisions) in seeds:
            batch["observation.state"] = batch["observation.state"] * np.nan
        return batch

    return observe


@pytest.fixture(scope="module")
def loaded(trained):
    return load_policy(trained)


RING = {"env_id": "RotatingRing-v2", "env_kwargs": {"representation": "nullspace", "control": "position"}}


def test_a_refused_decision_ends_its_episode_and_not_the_recording(loaded, tmp_path):
    policy, preprocess = loaded
    policy.config.n_action_steps = 8
    # Two decisions an episode: the second of episode 0 fails, then the first of episode 2.
    loop, _ = record_rollouts(policy, faulty(preprocess, {1, 4}), tmp_path / "loop", episodes=4, **RING)
    outcomes = read_rollout_sidecar(tmp_path / "loop" / "meta" / "dualhead.json")["outcomes"]
    assert [outcome["frames"] for outcome in outcomes] == [7, 16, 0, 16]
    assert [outcome["refused"] is None for outcome in outcomes] == [False, True, False, True]
    assert "refused 2 of 4" in str(loop)
    assert loop.refusals[0].startswith("episode 0 (seed 0) was refused after 7 steps: the observations")
    assert read_closed_loop(tmp_path / "loop")[1] == loop
    assert rollout_gate(tmp_path / "loop").counts.sum() == 1 + 2 + 2
    with pytest.raises(ValueError, match="every episode was refused before its first step"):
        record_rollouts(policy, faulty(preprocess, set(range(9))), tmp_path / "none", episodes=2, **RING)
    assert not (tmp_path / "none").exists()


def test_the_certificate_sees_fresh_pairs_alone(loaded, tmp_path):
    """Under an oracle token that the episode holds, n samples are n - 1 draws of a decision; one sample is none."""
    policy, preprocess = loaded
    assert held_pairs(policy) == 1
    with pytest.raises(ValueError, match="leaves no fresh pair"):
        record_rollouts(policy, preprocess, tmp_path / "loop", episodes=1, samples=1, **RING)
    record_rollouts(policy, preprocess, tmp_path / "loop", episodes=3, samples=5, **RING)
    gate = rollout_gate(tmp_path / "loop")
    assert (gate.counts.sum(axis=(-1, -2)) == 4).all()
    path = tmp_path / "loop" / "meta" / "dualhead.json"
    kept = json.loads(path.read_text())
    del kept["held_pairs"]
    path.write_text(json.dumps(kept))
    with pytest.raises(ValueError, match="record the rollouts again"):
        rollout_gate(tmp_path / "loop")
