"""Monitors attached to a policy: hooks that change nothing, and alarms in an unmodified lerobot-eval."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from dualhead_envs.dataset_columns import read_columns, read_info
from dualhead_eval.cli import main
from dualhead_eval.evaluation.closed_loop import record_rollouts
from dualhead_eval.evaluation.monitor_strip import monitor_strip
from dualhead_eval.monitor import Monitor
from dualhead_eval.monitor.monitor_file import save_monitor
from dualhead_eval.monitor.recorded_episodes import open_rollouts
from dualhead_eval.monitor.recording_watch import RecordedMonitor
from dualhead_eval.monitor.watching import watch
from dualhead_policy.disagreement_step import DisagreementMonitorStep
from dualhead_policy.pretrained import load_policy, policy_folder

ENV = {"representation": "nullspace", "control": "position"}


@pytest.fixture(scope="module")
def policy_path(trained, tmp_path_factory):
    """A briefly trained policy of the ring that decides twice an episode."""
    folder = shutil.copytree(policy_folder(trained), tmp_path_factory.mktemp("eight") / "P")
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"n_action_steps": 8}))
    return folder


@pytest.fixture(scope="module")
def loaded(policy_path):
    """The policy and its preprocessor."""
    return load_policy(policy_path)


@pytest.fixture(scope="module")
def recorded(loaded, tmp_path_factory):
    """Forty recorded episodes."""
    root = tmp_path_factory.mktemp("attached") / "rollouts"
    record_rollouts(*loaded, root, env_id="RotatingRing-v2", env_kwargs=ENV, episodes=40)
    return open_rollouts(root)


def fitted(recorded, signals, alpha=0.5):
    """A monitor that raises alarms in about ``alpha`` of such episodes."""
    monitor = Monitor(signals)
    return monitor.fit(list(recorded), alpha, rng=np.random.default_rng(0), allow_failures=True)


@pytest.fixture(scope="module")
def watched(policy_path, recorded, tmp_path_factory):
    """A policy's folder with a monitor attached, and the monitor."""
    folder = tmp_path_factory.mktemp("watched")
    monitor = fitted(recorded, ["residual_executed"])
    save_monitor(monitor, folder / "M", layout=recorded.layout, samples=2)
    assert (
        main(["monitor", "attach", str(folder / "M"), "--policy", str(policy_path), "--output", str(folder / "P")]) == 0
    )
    return folder / "P", monitor


def rolled_out(policy, preprocess, seed=0, steps=16):
    """Actions of one episode."""
    env = gym.make("dualhead_envs:RotatingRing-v2", **ENV)
    observation, _ = env.reset(seed=seed)
    torch.manual_seed(seed)
    policy.reset()
    actions = []
    for _ in range(steps):
        raw = {f"observation.{name}": torch.from_numpy(observation[key])[None]
               for key, name in (("agent_pos", "state"), ("environment_state", "environment_state"))}  # fmt: skip
        actions.append(policy.select_action(preprocess(raw))[0].numpy())
        observation, *_ = env.step(actions[-1][-2:])
    return np.stack(actions)


def test_a_watched_policy_executes_what_it_would_have_executed(loaded, recorded):
    policy, preprocess = loaded
    alone = rolled_out(policy, preprocess)
    monitor = fitted(recorded, ["residual_matched", "residual_executed", "max_abs_z"])
    with watch(policy, monitor, preprocess) as seen:
        beside = rolled_out(policy, preprocess)
        assert [len(row) for row in seen.readings] == [2]
        first = seen.readings[0][0]
        assert np.isfinite([reading.score for reading in first.by_signal.values()]).all()
        # The executed pair is the first: its distance is that of the executed actions.
        joint, position = (beside[:8, slice(*policy.representation.slices[head].indices(99)[:2])]
                           for head in ("joint", "position"))  # fmt: skip
        decoded = policy.model.kinematics.position(torch.from_numpy(joint).double()).numpy()
        expected = 1000 * np.linalg.norm(decoded - position, axis=-1).mean()
        assert first.by_signal["residual_executed"].score == pytest.approx(expected, rel=1e-5)
    np.testing.assert_array_equal(alone, beside)
    assert not policy.decision_hooks
    assert policy.monitor_samples == 1


def test_a_watch_begins_again_with_every_episode(loaded, recorded):
    policy, preprocess = loaded
    with watch(policy, fitted(recorded, ["residual_executed"]), preprocess) as seen:
        rolled_out(policy, preprocess, seed=1)
        before = [reading.score for reading in seen.readings[0]]
        rolled_out(policy, preprocess, seed=1)
        assert [reading.score for reading in seen.readings[0]] == before


def test_a_watch_without_the_policys_normalisation_is_refused(loaded, recorded):
    monitor = fitted(recorded, ["residual"])
    with pytest.raises(ValueError, match="no normalisation to undo"), watch(loaded[0], monitor, dict):
        pass


def test_the_step_raises_the_alarms_of_the_monitor(watched, recorded):
    folder, monitor = watched
    config = json.loads((folder / "policy_postprocessor.json").read_text())["steps"][1]["config"]
    step = DisagreementMonitorStep(**config)
    actions = read_columns(recorded.root, read_info(recorded.root), ["action"])["action"]
    alarms = 0
    for number in range(len(recorded)):
        step.reset()
        before = len(step.alarms)
        for frame in recorded.frames(number):
            step.action(torch.from_numpy(actions[frame])[None])
        readings = monitor.read(recorded.episode(number))
        if np.isclose([reading.aggregate for reading in readings], config["limit_mm"], rtol=1e-9, atol=0).any():
            continue  # the limit is this episode's own score, and the step adds up in another order
        raised = [8 * (index + 1) for index, reading in enumerate(readings) if reading.alarm][:1]
        assert [alarm["step"] for alarm in step.alarms[before:]] == raised
        alarms += len(raised)
    assert 5 < alarms < 35


def test_rows_of_a_batch_are_watched_apart(watched):
    config = json.loads((watched[0] / "policy_postprocessor.json").read_text())["steps"][1]["config"]
    step = DisagreementMonitorStep(**config | {"limit_mm": 500.0})
    agreeing, parted = torch.zeros(8), torch.zeros(8)
    parted[config["position"][0]] = 1.0
    for _ in range(8):
        step.action(torch.stack([agreeing, parted]))
    assert [(alarm["row"], alarm["step"]) for alarm in step.alarms] == [(1, 8)]


def test_a_watched_folder_loads_strictly(watched, tmp_path):
    load_policy(watched[0])
    folder = shutil.copytree(watched[0], tmp_path / "P")
    path = folder / "policy_postprocessor.json"
    whole = json.loads(path.read_text())
    for change in ({"limit_mm": -1.0}, {"kinematic_map": "panda"}, {"decision_steps": 0}, {"surprise": 1}):
        content = json.loads(json.dumps(whole))
        content["steps"][1]["config"] |= change
        path.write_text(json.dumps(content))
        with pytest.raises(ValueError, match=r"policy_postprocessor\.json") as refusal:
            load_policy(folder)
        assert "\n" not in str(refusal.value)


def test_a_recording_holds_the_monitors_readings(loaded, recorded, tmp_path):
    policy, preprocess = loaded
    monitor = fitted(recorded, ["residual", "residual_matched"])
    watcher = RecordedMonitor(monitor, "ring/nullspace", recorded.state_names, "position", recorded.builder.partition)
    root = tmp_path / "watched"
    record_rollouts(policy, preprocess, root, env_id="RotatingRing-v2", env_kwargs=ENV, episodes=5, watch=watcher)
    again = open_rollouts(root)
    names = [f"monitor.{name}" for name in ("score", "aggregate", "threshold", "alarm")]
    columns = read_columns(root, read_info(root), names)
    for number, episode in enumerate(again):
        readings = monitor.read(episode)
        for name in names:
            field = name.partition(".")[2]
            expected = np.repeat([getattr(reading, field) for reading in readings], 8)
            np.testing.assert_array_equal(
                columns[name][again.frames(number)].reshape(-1), expected.astype(columns[name].dtype)
            )
    # Whoever is watched acts as before.
    plain = tmp_path / "plain"
    record_rollouts(policy, preprocess, plain, env_id="RotatingRing-v2", env_kwargs=ENV, episodes=5)
    np.testing.assert_array_equal(
        *(read_columns(path, read_info(path), ["action"])["action"] for path in (root, plain))
    )


def test_a_strip_shows_what_has_been_read_so_far():
    aggregate, threshold = np.array([1.0, 1.0, 5.0, np.inf]), np.full(4, 2.0)
    alarm = aggregate > threshold
    early, late = (monitor_strip(300, aggregate, threshold, alarm, step) for step in (1, 3))
    assert early.shape == late.shape == (90, 300, 3)
    right = np.s_[:, 250:290]
    assert (late[right] < 255).sum() > 2 * (early[right] < 255).sum()


@pytest.mark.parametrize(("signal", "sentence"), [("residual", "expected residual_executed by ewma-max")])
def test_a_monitor_of_another_signal_is_not_attached(policy_path, recorded, tmp_path, capsys, signal, sentence):
    save_monitor(fitted(recorded, [signal]), tmp_path / "M", layout=recorded.layout, samples=2)
    arguments = [
        "monitor",
        "attach",
        str(tmp_path / "M"),
        "--policy",
        str(policy_path),
        "--output",
        str(tmp_path / "P"),
    ]
    assert main(arguments) != 0
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "P").exists()


def test_unmodified_lerobot_eval_raises_the_alarms(watched, tmp_path):
    command = [
        str(Path(sys.executable).parent / "lerobot-eval"),
        f"--policy.path={policy_folder(watched[0])}",
        "--policy.device=cpu",
        "--env.type=rotating_ring",
        "--env.representation=nullspace",
        "--env.control=position",
        "--eval.n_episodes=8",
        "--eval.batch_size=2",
        "--seed=5",
        f"--output_dir={tmp_path / 'eval'}",
    ]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert (tmp_path / "eval" / "eval_info.json").is_file()
    found = re.findall(r"disagreement alarm: episode (\d+), row (\d+), step (\d+): ([\d.]+) mm", ended.stderr)
    assert found
    assert len(found) < 8
    assert len({(episode, row) for episode, row, _, _ in found}) == len(found)
    limit = watched[1].channels[0].threshold.limit
    assert all(float(distance) > limit - 0.1 and int(step) in (8, 16) for _, _, step, distance in found)
