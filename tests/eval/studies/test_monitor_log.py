"""From a policy in the robot's environment to a log and scores on it: recorded once, whole or not at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualhead_envs.dataset_frames import read_split
from dualhead_eval.monitor.branch_flag import BranchFlag
from dualhead_eval.monitor.signals.registry import make_signal
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.log_table import collect_log, write_log
from dualhead_eval.studies.monitor.recording import parts, record_log
from dualhead_eval.studies.monitor.registration import registered
from dualhead_eval.studies.monitor.score_files import ScoreJob, score_file
from dualhead_eval.studies.monitor.scoring import score_arm
from dualhead_policy.pretrained import load_policy
from dualhead_policy.sampling import SamplingCoupling


@pytest.fixture(scope="module")
def executor(panda_data, tmp_path_factory):
    """A robot policy of five training steps."""
    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.trainer import Training

    output = tmp_path_factory.mktemp("runs") / "executor"
    flags = [
        "--steps=5",
        "--batch_size=16",
        "--policy.token=oracle",
        "--policy.device=cpu",
        "--policy.velocity_width=32",
    ]
    Training(
        parse_training_config([f"--dataset.root={panda_data / 'train'}", f"--output_dir={output}", *flags], None)
    ).run()
    return output


@pytest.fixture(scope="module")
def protocol():
    """Two nominal parts and one perturbation of one episode each."""
    made = registered()
    return made.model_copy(update={"log": made.log.model_copy(update={"cells": ["cube_bias@2"]})})


@pytest.fixture(scope="module")
def budget(protocol):
    sizes = {"calibration_episodes": 1, "calibration_kept": 1, "nominal_episodes": 1, "cell_episodes": 1}
    return protocol.presets["smoke"].model_copy(update=sizes)


@pytest.fixture(scope="module")
def recorded(executor, protocol, budget, tmp_path_factory):
    """Folder of the recorded parts."""
    folder = tmp_path_factory.mktemp("log")
    record_log(folder, executor, "v2", protocol, budget, env_kwargs={})
    return folder


@pytest.fixture(scope="module")
def log(recorded, protocol, budget, panda_data):
    return collect_log(recorded, protocol, budget, BranchFlag.from_split(read_split(panda_data / "train")))


def test_what_is_recorded_is_not_recorded_again(recorded, executor, protocol, budget):
    before = {path: path.stat().st_mtime_ns for path in recorded.rglob("*.parquet")}
    counted = []
    record_log(recorded, executor, "v2", protocol, budget, env_kwargs={}, progress=counted.append)
    assert counted == [1, 1, 1]
    assert {path: path.stat().st_mtime_ns for path in recorded.rglob("*.parquet")} == before


def test_a_part_of_other_seeds_is_refused(recorded, executor, protocol, budget):
    other = protocol.model_copy(update={"log": protocol.log.model_copy(update={"first_seed": 5})})
    with pytest.raises(ValueError, match="expected 1 from 5 in"):
        record_log(recorded, executor, "v2", other, budget, env_kwargs={})


def test_failures_do_not_calibrate(log):
    # Nobody succeeds after five training steps: the calibration part is left out, the test parts are kept.
    assert log.episodes["part"] == ["nominal", "cube_bias@2"]
    assert log.episodes["success"] == [False, False]
    assert [stratum.partition("@")[0] for stratum in log.episodes["stratum"]] == ["nominal", "cube_bias"]
    assert (np.diff(log.step[log.rows(0)]) == 8).all()


def score(log, executor, seed=(1, 2)):
    policy, preprocess = load_policy(executor)
    signals = ["residual", "residual_matched"]
    return score_arm(log, policy, preprocess, samples=4, seed=seed, signals=signals, provenance={})


def test_scores_are_a_function_of_their_seeds(log, executor):
    first, again, other = score(log, executor), score(log, executor), score(log, executor, seed=(1, 3))
    for name, values in first.scores.items():
        np.testing.assert_array_equal(values, again.scores[name])
        assert (values != other.scores[name]).any()
    assert first.entropy == pytest.approx(np.full(len(log), np.log(2)), abs=1e-6)  # a uniform oracle token
    assert first.pairs.sum() <= 4 * len(log)


def test_an_arm_is_scored_under_its_own_coupling(log, executor, tmp_path):
    """The same policy through its file: aligned noise gives other pairs, and the file says what they shared."""
    write_log(log, tmp_path / "log.parquet")
    scoring = registered().scoring.model_copy(update={"samples": 4, "signals": ["residual"]})
    couplings = {"own": None, "aligned": SamplingCoupling(source_noise_beta=0.0, source_noise_alignment="kinematic")}
    for name, coupling in couplings.items():
        job = ScoreJob(executor, tmp_path / f"{name}.parquet", 1, coupling)
        score_file(tmp_path / "log.parquet", job, scoring, "cpu")
    own, aligned = (ArmScores.read(tmp_path / f"{name}.parquet") for name in couplings)
    assert (own.scores["residual"] != aligned.scores["residual"]).any()
    assert "coupling" not in own.provenance
    assert aligned.provenance["coupling"]["source_noise_alignment"] == "kinematic"


def test_scores_are_the_monitors_own(log, executor):
    """The residual of the first drawn pair, by the signal that a monitor beside the robot uses."""
    import torch

    scored = score(log, executor)
    policy, preprocess = load_policy(executor)
    state = np.random.SeedSequence([1, 2, 0]).generate_state(1)[0]
    batch = preprocess({key: torch.from_numpy(values) for key, values in log.observations.items()})
    drawn = policy.sample(batch, 4, generator=torch.Generator().manual_seed(int(state)))
    builder, signal = log.builder(), make_signal("residual_matched")
    state_key, context_key = log.observations
    for row in (0, len(log) - 1):
        decision = builder.build(
            0, log.observations[state_key][row], log.observations[context_key][row],
            drawn.joint[row].numpy(), drawn.position[row].numpy(),
        )  # fmt: skip
        assert scored.scores["residual_matched"][row] == pytest.approx(signal.score(decision), rel=1e-6)


def test_a_log_without_observations_is_not_scored(log, executor):
    with pytest.raises(ValueError, match="kept without observations"):
        score(replace(log, observations={}), executor)


def test_the_order_of_the_parts_is_the_protocols(protocol, budget):
    assert [part.name for part in parts(protocol, budget)] == ["calibration", "nominal", "cube_bias@2"]
