"""Policies with an orientation head: its modes by the partition's companion rule, its residual in degrees."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from scipy.spatial.transform import Rotation

from dualhead_envs.dataset_frames import read_split
from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, make_gate
from dualhead_eval.evaluation.open_loop import evaluate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler
from dualhead_eval.report.content import make_report
from dualhead_eval.report.tables import agreement_table
from dualhead_policy import DualheadConfig

N = 40


def turned(columns, degrees):
    """6-D rotations turned about the world's z axis."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return np.concatenate([columns[..., :3] @ turn.T, columns[..., 3:] @ turn.T], axis=-1)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """One recorded pair of RotatingBypass-v3: windows of both modes after the branch, by mode, and their condition."""
    from dualhead_envs.bypass.record import record_bypass

    root = tmp_path_factory.mktemp("v3") / "data"
    record_bypass("RotatingBypass-v3", root, pairs=3, workers=1, progress=False)
    frames = read_split(root / "train")
    windows = []
    for mode in (0, 1):
        (start, *_) = np.flatnonzero(
            (frames.frame_index == frames.labels["branch_step"]) & (frames.labels["mode"] == mode)
        )
        windows.append(frames.action[start : start + 16].astype(np.float64))
    condition = frames.observation["observation.environment_state"][start]
    return np.stack(windows), condition


def test_an_orientation_head_is_counted_by_its_companion_rule(pair):
    windows, condition = pair
    partition = gym.make("dualhead_envs:RotatingBypass-v3").unwrapped.mode_partition
    rng = np.random.default_rng(0)
    mode, other = rng.integers(2, size=(2, 1, N))
    position, columns = windows[..., 7:10], windows[..., 10:16]
    pairs = LabelledPairs.from_paths(
        position[mode], position[mode], condition[None], partition, None, (columns[mode], turned(columns[other], 2.0))
    )
    assert pairs.heads == ("joint", "position", "rotation")
    same_turn = pairs.residuals["rotation"].distance[mode == other]
    assert same_turn == pytest.approx(2.0, abs=1e-6)
    gate = make_gate(
        {20: pairs},
        reference_nfe=20,
        taus=[0.05],
        conditions=condition[None],
        pair_ids=np.zeros(1),
        partition=partition,
        target_probabilities=None,
        provenance={"label": "pose"},
    )
    table = gate.pair_table(0, 2, tau=0.05)[0, :2, :2]
    assert table.sum() == N
    expected = np.array([[((mode == a) & (other == b)).sum() for b in (0, 1)] for a in (0, 1)])
    assert np.array_equal(table, expected)
    assert gate.strata["rotation"].unit == "deg"
    (row,) = agreement_table(make_report([gate])).rows
    assert row[:2] == ("pose", "joint, position, rotation")


def test_where_all_modes_share_one_orientation_only_its_residual_is_kept(panda_data):
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    small = {"velocity_width": 16, "encoder_dim": 8, "seed": 0, "device": "cpu"}
    policy = make_policy(DualheadConfig(rotation_head=True, **small), ds_meta=meta).eval()
    sampler = EvaluatedSampler(policy, dict, policy.model.kinematics, {"method": "policy"})
    protocol = EvaluationProtocol(pairs=4, nfes=[2])
    gate = evaluate(sampler, open_conditions(panda_data / "test"), protocol, "untrained")
    assert gate.heads == ("joint", "position")
    assert gate.strata["rotation"].unit == "deg"
