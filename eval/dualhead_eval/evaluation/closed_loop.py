"""Recorded rollouts of a two-head policy: LeRobotDatasets with both heads' predictions at every decision.

Beside the frames as executed (observations, dual action, reward), a rollout dataset holds

- ``prediction.joint`` (n * H * d_A,) and ``prediction.position`` (n * H * d,): n >= 2 sampled chunks of each
head
  in physical units, flattened, at decision frames (zeros elsewhere);
- ``prediction.decision`` (1,): whether the policy decided in this frame;
- ``certificate.*`` (1,): residual, verdict (its index), effect and capacity of the runtime certificate, which runs
  beside the robot over all episodes;
- ``meta/dualhead.json``: environment, horizon and n, and what became of every episode.

The keys do not begin with ``action``, which LeRobot would take for an action. Every decision is a condition
of its own when the predictions are counted.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from filelock import FileLock, Timeout

from dualhead_envs.dataset_frames import read_columns
from dualhead_eval.certificate.wrapper import CERTIFICATE_FEATURES, CertificateWrapper, certificate_columns
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs
from dualhead_eval.evaluation.open_loop import make_gate
from dualhead_eval.evaluation.rollouts import ROLLOUTS_FORMAT, ClosedLoop, closed_loop_of
from dualhead_eval.gate.gate import ROLLOUTS, Gate
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.representation import RepresentationLayout
from dualhead_policy.sampling import SamplingCoupling

OBSERVATIONS = {"agent_pos": "observation.state", "environment_state": "observation.environment_state"}


def record_rollouts(
    policy: DualheadPolicy,
    preprocess: Callable[[Any], Any],
    root: str | Path,
    *,
    env_id: str,
    env_kwargs: dict[str, Any],
    episodes: int,
    samples: int = 2,
    seed: int = 0,
    provenance: Mapping[str, Any] | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[ClosedLoop, str]:
    """Roll a policy out and record what it executed and what both heads predicted.

    At every decision ``samples`` chunks of both heads are drawn, each pair with a token or latent of its own (if the
    policy has them). The first pair follows those of the episode, and its chunk is executed for ``n_action_steps``
    steps; were the others to follow them too, both heads would seem collapsed onto one mode.

    Args:
        policy: The policy, in evaluation mode.
        preprocess: Its preprocessor.
        root: Folder of the dataset; must not exist.
        env_id: Registered id, for example ``"RotatingRing-v2"``.
        env_kwargs: Its keyword arguments, among them ``control``: which head drives.
        episodes: Episodes to record; episode i is reset with seed ``seed + i``.
        samples: Chunks per head and decision, at least 2 for within-decision coordination.
        seed: Seed of environment and draws.
        provenance: What to say of the policy in ``meta/dualhead.json``.
        progress: Called with 1 after every episode.

    Returns:
        What became of the episodes, and the certificate's verdict after the last.

    Raises:
        FileExistsError: If ``root`` exists.
        BlockingIOError: If another process records into ``root``.
        ValueError: If ``samples`` or ``episodes`` is below 1, or the policy has another layout.
    """
    root = Path(root)
    if root.exists():
        raise FileExistsError(f"{root} already exists: choose another folder, or delete it first")
    if samples < 1 or episodes < 1:
        raise ValueError(f"samples={samples} and episodes={episodes} must be at least 1")
    env = gym.make(f"dualhead_envs:{env_id}", **env_kwargs)
    layout = env.unwrapped.layout  # type: ignore[attr-defined]
    expected = RepresentationLayout.from_names(layout.action_names)
    policy.representation.require_same(expected, owner="the policy", given=f"environment {env_id}")
    executed = layout.control_indices(env_kwargs["control"])
    horizon = policy.config.chunk_size
    features = {
        key: feature for key, feature in layout.dataset_features().items() if key.startswith(("observation.", "action"))
    }
    for head, dim in policy.model.head_dims.items():
        features[f"prediction.{head}"] = {
            "dtype": "float32",
            "shape": (samples * horizon * dim,),
            "names": None,
        }
    features |= CERTIFICATE_FEATURES
    features["prediction.decision"] = {"dtype": "bool", "shape": (1,), "names": None}
    features["next.reward"] = {"dtype": "float32", "shape": (1,), "names": None}
    features["next.success"] = {"dtype": "bool", "shape": (1,), "names": None}
    with _claimed(root) as staging:
        dataset = _create_dataset(staging, root.name, layout.fps, features)
        decisions = _Decisions(policy, preprocess, samples, layout.name)
        watched = CertificateWrapper(env, decisions, decision_interval=policy.config.n_action_steps or 1)
        outcomes = []
        for episode in range(episodes):
            outcomes.append(_roll_out(watched, decisions, dataset, executed, seed + episode))
            dataset.save_episode()
            if progress is not None:
                progress(1)
        dataset.finalize()
        sidecar = {
            "format": ROLLOUTS_FORMAT,
            "env_id": env_id,
            "env_kwargs": env_kwargs,
            "layout": layout.name,
            "horizon": horizon,
            "samples": samples,
            "num_inference_steps": policy.config.num_inference_steps,
            "seed": seed,
            "partition": env.unwrapped.mode_partition.to_dict(),  # type: ignore[attr-defined]
            "outcomes": outcomes,
            "policy": dict(provenance or {}),
        }
        (staging / "meta" / "dualhead.json").write_text(json.dumps(sidecar, indent=2))
        _publish(staging, root)
        env.close()
        loop = closed_loop_of(sidecar)
        assert loop is not None
        return loop, watched.certificate.verdict


@contextlib.contextmanager
def _claimed(root: Path) -> Iterator[Path]:
    """A staging folder beside ``root``, emptied of what a killed recording left, for this process alone.

    Raises:
        BlockingIOError: If another process records into ``root``.
    """
    root.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(root.with_name(f".{root.name}.lock"), timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise BlockingIOError(
            f"another process records rollouts into {root}: wait, or choose another folder"
        ) from error
    try:
        staging = root.with_name(f".{root.name}.partial")
        shutil.rmtree(staging, ignore_errors=True)
        yield staging
        shutil.rmtree(staging, ignore_errors=True)
    finally:
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def _publish(staging: Path, root: Path) -> None:
    if root.exists():
        raise FileExistsError(
            f"{root} was filled in the meantime: choose another folder; this recording is in {staging}"
        )
    staging.rename(root)


def _create_dataset(staging: Path, name: str, fps: int, features: dict[str, dict]) -> Any:
    from lerobot.datasets import LeRobotDataset

    return LeRobotDataset.create(
        f"local/{name}", fps=fps, features=features, root=staging, use_videos=False, video_backend="pyav"
    )


class _Decisions:
    """Samples both heads whenever the certificate's wrapper decides, and keeps what the rollout needs.

    Args:
        policy: The policy.
        preprocess: Its preprocessor.
        samples: Chunks per head and decision.
        kinematic_map: Map from head A's space to the position.
        generator: Source of all draws of one episode.
    """

    def __init__(
        self, policy: DualheadPolicy, preprocess: Callable[[Any], Any], samples: int, kinematic_map: str
    ) -> None:
        self.policy, self.preprocess, self.samples = policy, preprocess, samples
        self.to_position = KinematicMap(kinematic_map).position
        self.blank = {
            f"prediction.{head}": np.zeros(samples * policy.config.chunk_size * dim, dtype=np.float32)
            for head, dim in policy.model.head_dims.items()
        }

    def start(self, seed: int) -> None:
        """Begin an episode: its draws, and its token or latent."""
        self.policy.reset()
        self.generator = torch.Generator().manual_seed(seed)
        self.token: torch.Tensor | None = None
        self.latent: torch.Tensor | None = None

    def __call__(self, observation: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Decide: sample both heads, keep the chunk to execute, return both heads' paths (n, H, d) in metres."""
        policy = self.policy
        raw = {OBSERVATIONS[key]: torch.from_numpy(observation[key])[None] for key in OBSERVATIONS}
        batch = self.preprocess(raw)
        token = policy.draw_tokens(batch, self.samples, self.generator)
        # A window token belongs to its window; the others are the episode's.
        if token is not None and policy.config.token != "window":
            if self.token is not None:
                token[:, 0] = self.token
            self.token = token[:, 0]
        latent = None
        if policy.model.shared_latent is not None:
            latent = policy.model.shared_latent.draw((1, self.samples), self.generator)
            if self.latent is not None:
                latent[:, 0] = self.latent
            self.latent = latent[:, 0]
        coupling = SamplingCoupling(token=token, latent=latent)
        drawn = policy.sample(batch, self.samples, coupling=coupling, generator=self.generator)
        self.predictions = {
            f"prediction.{head}": getattr(drawn, head)[0].flatten().cpu().numpy() for head in policy.model.head_dims
        }
        self.chunk = list(policy.dual_chunk(drawn)[0, : policy.config.n_action_steps].cpu().numpy())
        joint = self.to_position(drawn.joint[0].double())
        return joint.cpu().numpy(), drawn.position[0].double().cpu().numpy()


def _roll_out(env: CertificateWrapper, decisions: _Decisions, dataset: Any, executed: np.ndarray, seed: int) -> Any:
    """Run and record one episode; returns what became of it."""
    decisions.start(seed)
    observation, info = env.reset(seed=seed)
    done = False
    while not done:
        decided = info["coordination"]["decision"]
        certificate = certificate_columns(info)
        action = decisions.chunk.pop(0)
        after, reward, terminated, truncated, info = env.step(action[executed])
        dataset.add_frame(
            {
                **{OBSERVATIONS[key]: observation[key] for key in OBSERVATIONS},
                "action": action,
                **(decisions.predictions if decided else decisions.blank),
                "prediction.decision": np.array([decided]),
                **certificate,
                "next.reward": np.array([reward], dtype=np.float32),
                "next.success": np.array([bool(info["is_success"])]),
                "task": str(env.unwrapped.task_description),  # type: ignore[attr-defined]
            }
        )
        observation, done = after, terminated or truncated
    return {
        "seed": seed,
        "success": bool(info["is_success"]),
        "collision": bool(info["collision"]),
        "mode": int(info["mode"]),
    }


def rollout_gate(root: str | Path, *, taus: Sequence[float] = (), label: str | None = None) -> Gate:
    """Count the predictions of a rollout dataset: every decision is a condition of its own.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it holds no predictions of both heads.
    """
    root = Path(root)
    info_path, sidecar_path = root / "meta" / "info.json", root / "meta" / "dualhead.json"
    if not info_path.is_file():
        raise FileNotFoundError(f"{root} is not a LeRobotDataset (no meta/info.json): give a rollout dataset")
    info = json.loads(info_path.read_text())
    sidecar = json.loads(sidecar_path.read_text()) if sidecar_path.is_file() else {}
    keys = ["prediction.joint", "prediction.position", "prediction.decision"]
    missing = [key for key in keys if key not in info["features"]]
    if missing or sidecar.get("format") != ROLLOUTS_FORMAT:
        raise ValueError(
            f"{root} is not a dataset of recorded rollouts (lacks "
            f"{missing or ROLLOUTS_FORMAT + ' in meta/dualhead.json'}): "
            "record one with `dualhead evaluate --policy ... --record DIR`"
        )
    columns = read_columns(root, info, [*keys, "observation.environment_state", "episode_index"])
    decision = columns["prediction.decision"].reshape(-1).astype(bool)
    if not decision.any():
        raise ValueError(f"{root} holds no decision: expected prediction.decision to be true in some frames")
    n, horizon = sidecar["samples"], sidecar["horizon"]

    def chunks(key: str) -> np.ndarray:
        return columns[key][decision].reshape(int(decision.sum()), n, horizon, -1)

    env = gym.make(f"dualhead_envs:{sidecar['env_id']}", **sidecar["env_kwargs"])
    partition = env.unwrapped.mode_partition  # type: ignore[attr-defined]
    env.close()
    condition = columns["observation.environment_state"][decision]
    joint = torch.from_numpy(chunks("prediction.joint")).double()
    pairs = LabelledPairs.from_paths(
        KinematicMap(sidecar["layout"]).position(joint).numpy(),
        chunks("prediction.position").astype(np.float64),
        condition,
        partition,
    )
    nfe = sidecar["num_inference_steps"]
    return make_gate(
        {nfe: pairs},
        reference_nfe=nfe,
        taus=taus,
        conditions=condition,
        pair_ids=columns["episode_index"][decision],
        partition=partition,
        target_probabilities=None,
        provenance={"label": label or root.name, "method": ROLLOUTS, "rollouts": sidecar},
    )
