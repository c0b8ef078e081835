"""Decisions of a ring, and rollout datasets in the format of ``dualhead evaluate --record``."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dualhead_envs.ring.layout import ring_layout
from dualhead_envs.ring.maps import REPRESENTATION_MAPS
from dualhead_envs.ring.partition import RingPartition
from dualhead_eval.monitor.decision import Decision, Episode

HORIZON, WIDTH = 16, REPRESENTATION_MAPS["nullspace"].width


def ring_paths(rng, n, modes, noise=0.01):
    """Noisy paths (n, 16, 2) of a two-mode ring at angle 0 toward the given modes."""
    rise = np.sin(np.pi * np.arange(HORIZON) / 15)
    sign = 1 - 2 * np.asarray(modes)
    path = np.zeros((n, HORIZON, 2))
    path[..., 0] = sign[:, None] * rise
    return path + noise * rng.standard_normal(path.shape)


def random_decision(rng, step=0, n=6, dim=3, width=5, **more):
    """A decision without structure."""
    joint, position = rng.standard_normal((n, HORIZON, 7)), 0.1 * rng.standard_normal((n, HORIZON, dim))
    decoded = 0.1 * rng.standard_normal((n, HORIZON, dim))
    return Decision(step, rng.standard_normal(width), joint, position, decoded, rng.standard_normal(dim), **more)


def random_episode(rng, decisions=6, success=True, shift=0.0, key="", **more):
    """Decisions eight steps apart, whose observations and decodings drift by ``shift``."""
    made = []
    for index in range(decisions):
        d = random_decision(rng, 8 * index)
        made.append(Decision(d.step, d.observation + shift, d.joint, d.position, d.decoded + 0.1 * shift, d.site))
    failure = "none" if success else "timeout"
    return Episode(tuple(made), success, failure, steps=8 * decisions, key=key or f"made/{rng.integers(1e9)}", **more)


def write_rollouts(root, episodes, *, seed=0, samples=4, share=0.0, failing=0, first_seed=0, spread=0.01):
    """A rollout dataset of the two-mode ring: 24-step episodes, a decision every eight.

    The heads follow one mode in a share of the pairs; the first ``failing`` episodes fail, and their two heads
    disagree by ten times the noise of the others.
    """
    rng = np.random.default_rng(seed)
    layout = ring_layout("nullspace")
    encode = np.linalg.pinv(np.asarray(REPRESENTATION_MAPS["nullspace"].matrix))
    steps, rows, outcomes = 24, {}, []
    rows = {
        name: []
        for name in (
            "observation.state",
            "observation.environment_state",
            "prediction.joint",
            "prediction.position",
            "prediction.decision",
            "episode_index",
            "index",
        )
    }
    for episode in range(episodes):
        failed = episode < failing
        for step in range(steps):
            decided = step % 8 == 0
            a = rng.integers(0, 2, samples)
            b = np.where(rng.random(samples) < share, a, rng.integers(0, 2, samples))
            noise = spread * (10 if failed else 1)
            paths = ring_paths(rng, samples, a, noise), ring_paths(rng, samples, b, noise)
            joint, position = ((x if decided else 0 * x) for x in (paths[0] @ encode, paths[1]))
            values = (
                rng.normal(0, 0.1, 2),
                np.array([1.0, 0.0, 1.0]),
                joint.ravel(),
                position.ravel(),
                decided,
                episode,
                len(rows["index"]),
            )
            for name, value in zip(rows, values, strict=True):
                rows[name].append(value)
        outcomes.append(
            {"seed": first_seed + episode, "success": not failed, "collision": failed, "mode": 0, "frames": steps}
        )
    table = {}
    for name, values in rows.items():
        if name in ("episode_index", "index"):
            table[name] = pa.array(values, pa.int64())
        elif name == "prediction.decision":
            table[name] = pa.array(values, pa.bool_())
        else:
            stacked = np.stack(values).astype(np.float32)
            table[name] = pa.FixedSizeListArray.from_arrays(pa.array(stacked.ravel()), stacked.shape[1])
    (root / "data" / "chunk-000").mkdir(parents=True)
    (root / "meta").mkdir()
    pq.write_table(pa.table(table), root / "data" / "chunk-000" / "file-000.parquet")
    widths = {name: np.size(values[0]) for name, values in rows.items()}
    features = {name: {"dtype": "float32", "shape": [width], "names": None} for name, width in widths.items()}
    for name, dtype in (("episode_index", "int64"), ("index", "int64"), ("prediction.decision", "bool")):
        features[name]["dtype"] = dtype
    features["observation.state"]["names"] = [dimension.name for dimension in layout.agent_pos]
    info = {"codebase_version": "v3.0", "fps": 20, "features": features}
    info |= {"total_episodes": episodes, "total_frames": len(rows["index"])}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    sidecar = {
        "format": "dualhead-rollouts/1",
        "env_id": "RotatingRing-v2",
        "env_kwargs": {"representation": "nullspace", "control": "position"},
        "layout": "ring/nullspace",
        "horizon": HORIZON,
        "samples": samples,
        "held_pairs": 0,
        "num_inference_steps": 20,
        "seed": first_seed,
        "partition": RingPartition(2).to_dict(),
        "outcomes": outcomes,
    }
    (root / "meta" / "dualhead.json").write_text(json.dumps(sidecar))
    return root


@pytest.fixture(scope="session")
def make_decision():
    """:func:`random_decision`."""
    return random_decision


@pytest.fixture(scope="session")
def make_episode():
    """:func:`random_episode`."""
    return random_episode


@pytest.fixture(scope="session")
def make_rollouts():
    """:func:`write_rollouts`."""
    return write_rollouts


@pytest.fixture(scope="session")
def rollouts(tmp_path_factory):
    """Folders: 40 successes to calibrate on, 40 episodes of which 12 fail to test on."""
    folder = tmp_path_factory.mktemp("rollouts")
    return {
        "calibration": write_rollouts(folder / "calibration", 40, share=1.0),
        "test": write_rollouts(folder / "test", 40, seed=1, share=1.0, failing=12, first_seed=1000),
    }
