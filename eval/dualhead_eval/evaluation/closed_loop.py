"""Closed loop: roll a two-head policy out and record it as a LeRobotDataset with both heads' predictions.

Beside the frames as executed (observations, dual action, reward), a rollout dataset holds

- ``prediction.joint`` (n * H * d_A,) and ``prediction.position`` (n * H * d,): n >= 2 sampled chunks of each head in
  physical units, flattened, at decision frames (zeros elsewhere); with a third head ``prediction.rotation`` too;
- ``prediction.decision`` (1,): whether the policy decided in this frame;
- ``certificate.*`` (1,): residual, verdict (its index), effect and capacity of the runtime certificate, which runs
  beside the robot over all episodes;
- ``meta/dualhead.json``: environment, horizon and n, and what became of every episode.

The keys do not begin with ``action``, which LeRobot would take for an action. How the predictions are counted is
said in :mod:`dualhead_eval.evaluation.rollouts`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from dualhead_envs.recording.staging import publish, staging_folder
from dualhead_eval.certificate.wrapper import CERTIFICATE_FEATURES, CertificateWrapper, certificate_columns
from dualhead_eval.evaluation.rollouts import ROLLOUTS_FORMAT, ClosedLoop, closed_loop_of
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
        root: Folder of the dataset; must not hold anything.
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
        FileExistsError: If ``root`` holds anything.
        BlockingIOError: If another process records into ``root``.
        ValueError: If ``samples`` or ``episodes`` is below 1, the policy has another layout, or lacks the head that is
            to drive.
    """
    root = Path(root).resolve()
    if samples < 1 or episodes < 1:
        raise ValueError(f"samples={samples} and episodes={episodes} must be at least 1")
    control = env_kwargs["control"]
    if control == "pose" and "rotation" not in policy.model.head_dims:
        raise ValueError(
            "control='pose' executes the orientation head, which this policy lacks: choose 'joint' or 'position', or "
            "train with --policy.rotation_head=true"
        )
    env = gym.make(f"dualhead_envs:{env_id}", **env_kwargs)
    layout = env.unwrapped.layout  # type: ignore[attr-defined]
    expected = RepresentationLayout.from_names(layout.action_names)
    policy.representation.require_same(expected, owner="the policy", given=f"environment {env_id}")
    executed = layout.control_indices(control)
    sidecar: dict[str, Any] = {
        "format": ROLLOUTS_FORMAT,
        "env_id": env_id,
        "env_kwargs": env_kwargs,
        "layout": layout.name,
        "horizon": policy.config.chunk_size,
        "samples": samples,
        "num_inference_steps": policy.config.num_inference_steps,
        "seed": seed,
        "partition": env.unwrapped.mode_partition.to_dict(),  # type: ignore[attr-defined]
    }
    with staging_folder(root) as folder:
        features = _features(layout.dataset_features(), policy, samples)
        dataset = _create_dataset(folder / "dataset", root.name, layout.fps, features)
        decisions = _Decisions(policy, preprocess, samples)
        watched = CertificateWrapper(env, decisions, decision_interval=policy.config.n_action_steps or 1)
        outcomes = []
        for episode in range(episodes):
            outcomes.append(_roll_out(watched, decisions, dataset, executed, seed + episode))
            dataset.save_episode()
            if progress is not None:
                progress(1)
        dataset.finalize()
        env.close()
        sidecar |= {"outcomes": outcomes, "policy": dict(provenance or {})}
        (folder / "dataset" / "meta" / "dualhead.json").write_text(json.dumps(sidecar, indent=2), encoding="utf-8")
        publish(folder / "dataset", root)
    loop = closed_loop_of(sidecar)
    assert loop is not None
    return loop, watched.certificate.verdict


def _features(demonstrated: Mapping[str, dict], policy: DualheadPolicy, samples: int) -> dict[str, dict]:
    """LeRobotDataset features of rollouts, given those of demonstrations."""
    features = {key: feature for key, feature in demonstrated.items() if key.startswith(("observation.", "action"))}
    for head, dim in policy.model.head_dims.items():
        shape = (samples * policy.config.chunk_size * dim,)
        features[f"prediction.{head}"] = {"dtype": "float32", "shape": shape, "names": None}
    flags = ("prediction.decision", "next.success")
    return {
        **features,
        **CERTIFICATE_FEATURES,
        **{key: {"dtype": "bool", "shape": (1,), "names": None} for key in flags},
        "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
    }


def _create_dataset(root: Path, name: str, fps: int, features: dict[str, dict]) -> Any:
    from lerobot.datasets import LeRobotDataset

    return LeRobotDataset.create(
        f"local/{name}", fps=fps, features=features, root=root, use_videos=False, video_backend="pyav"
    )


class _Decisions:
    """Samples both heads whenever the certificate's wrapper decides, and keeps what the rollout needs.

    Args:
        policy: The policy.
        preprocess: Its preprocessor.
        samples: Chunks per head and decision.

    Attributes:
        generator: Source of all draws of one episode.
        predictions: The last decision's chunks, as the dataset's columns.
        chunk: Dual actions of the last decision that are still to be executed.
    """

    def __init__(self, policy: DualheadPolicy, preprocess: Callable[[Any], Any], samples: int) -> None:
        self.policy, self.preprocess, self.samples = policy, preprocess, samples
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
        joint = policy.model.kinematics.position(drawn.joint[0].double())
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
        # Robot environments say why an episode failed, and when its perturbation began.
        **{key: info[key] for key in ("failure", "onset") if key in info},
    }
