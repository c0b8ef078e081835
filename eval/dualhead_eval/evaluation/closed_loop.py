"""Closed loop: roll a policy out and record it as a LeRobotDataset with the predictions of every decision.

Beside the frames as executed (observations, dual action, reward), a rollout dataset holds

- ``prediction.joint`` (n * H * d_A,) and ``prediction.position`` (n * H * d,): n >= 2 sampled chunks of each head in
  physical units, flattened, at decision frames (zeros elsewhere); with a third head ``prediction.rotation`` too;
- of a policy of LeRobot's other types instead ``prediction.draw_1`` and ``prediction.draw_2`` (n * H * d,): the
  positions of n pairs of independent draws, of which the very first is executed;
- ``prediction.decision`` (1,): whether the policy decided in this frame;
- ``certificate.*`` (1,): residual, verdict (its index), effect and capacity of the runtime certificate, which runs
  beside the robot over all episodes;
- with a failure monitor beside the robot, ``monitor.*`` (1,): its score, aggregate, threshold and alarm;
- ``meta/dualhead.json``: environment, horizon and n, how many pairs of a decision follow what the episode holds, and
  what became of every episode: its seed, frames, outcome, and why a decision was refused (no frame: not in the data).

The keys do not begin with ``action``, which LeRobot would take for an action. How the predictions are counted is
said in :mod:`dualhead_eval.evaluation.rollouts`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from dualhead_envs.recorded_environment import make_recorded
from dualhead_envs.recording.staging import publish, staging_folder
from dualhead_eval.certificate.wrapper import CERTIFICATE_FEATURES, CertificateWrapper, certificate_columns
from dualhead_eval.evaluation.decisions import OBSERVATIONS, Decider, Decisions
from dualhead_eval.evaluation.rollouts import ROLLOUTS_FORMAT, ClosedLoop, closed_loop_of
from dualhead_policy.modeling_dualhead import DualheadPolicy

#: Longest reason of a refusal that is kept, in characters.
LONGEST_REASON = 500
#: What an episode's outcome takes from the environment's ``info``: name, key, type.
OUTCOME = (("success", "is_success", bool), ("collision", "collision", bool), ("mode", "mode", int))


class RolloutWatch(Protocol):
    """Follows recorded episodes: a wrapper that reads every decision, and the columns that it adds.

    Attributes:
        features: LeRobotDataset features of the columns.
    """

    features: dict[str, dict[str, Any]]

    def wrap(self, env: gym.Env, decisions: Decider) -> gym.Env:
        """The environment, followed; when it decides, ``decisions`` holds what was sampled."""

    def columns(self, info: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """One frame's values from ``info``."""


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
    watch: RolloutWatch | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[ClosedLoop, str]:
    """Roll a policy out and record what it executed and what both heads predicted.

    At every decision ``samples`` chunks of both heads are drawn, each pair with a token or latent of its own (if the
    policy has them). The first pair follows those of the episode, and its chunk is executed for ``n_action_steps``
    steps; were the others to follow them too, both heads would seem collapsed onto one mode. Where the policy holds a
    token or latent, the certificate sees the other pairs alone: they are the decision's own draws.

    An episode in which a decision is refused (a chunk that is not finite, an action that the environment does not take)
    ends there, counts as a failure and keeps its frames; the recording goes on with the next.

    Args:
        policy: The policy, in evaluation mode.
        preprocess: Its preprocessor.
        root: Folder of the dataset; must not hold anything.
        env_id: Registered id, for example ``"RotatingRing-v2"``.
        env_kwargs: Its keyword arguments, among them ``control``: which head drives.
        episodes: Episodes to record; episode i is reset with seed ``seed + i``.
        samples: Pairs of chunks per decision, at least 2 for within-decision coordination.
        seed: Seed of environment and draws.
        provenance: What to say of the policy in ``meta/dualhead.json``.
        watch: Who else follows the episodes and adds columns, for example a failure monitor.
        progress: Called with 1 after every episode.

    Returns:
        What became of the episodes, and the certificate's verdict after the last.

    Raises:
        FileExistsError: If ``root`` holds anything.
        BlockingIOError: If another process records into ``root``.
        ValueError: If ``samples`` or ``episodes`` is below 1, ``samples`` leaves no fresh pair, the policy has another
            layout, lacks the head that is to drive, or was refused before the first step of every episode.
    """
    if samples < 1:
        raise ValueError(f"samples={samples} is not positive: give at least 1")
    decisions = Decisions(policy, preprocess, samples)
    return record_decisions(
        decisions,
        root,
        env_id=env_id,
        env_kwargs=env_kwargs,
        episodes=episodes,
        seed=seed,
        provenance=provenance,
        watch=watch,
        progress=progress,
    )


def record_decisions(
    decisions: Decider,
    root: str | Path,
    *,
    env_id: str,
    env_kwargs: dict[str, Any],
    episodes: int,
    seed: int = 0,
    provenance: Mapping[str, Any] | None = None,
    watch: RolloutWatch | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[ClosedLoop, str]:
    """Roll out what decides, of whichever policy; see :func:`record_rollouts`.

    Raises:
        FileExistsError: If ``root`` holds anything.
        BlockingIOError: If another process records into ``root``.
        ValueError: If ``episodes`` is below 1, the policy has another layout, cannot drive by this control, or was
            refused before the first step of every episode.
    """
    root = Path(root).resolve()
    if episodes < 1:
        raise ValueError(f"episodes={episodes} is not positive: give at least 1")
    if seed < 0:
        raise ValueError(f"seed={seed} is negative, which no environment takes: give 0 or more")
    control = env_kwargs["control"]
    decisions.require_control(control)
    env = make_recorded(env_id, env_kwargs, "the dataset")
    layout = env.unwrapped.layout  # type: ignore[attr-defined]
    decisions.require_layout(layout, env_id)
    executed = layout.control_indices(control)
    sidecar: dict[str, Any] = {
        "format": ROLLOUTS_FORMAT,
        "env_id": env_id,
        "env_kwargs": env_kwargs,
        "layout": layout.name,
        "horizon": decisions.horizon,
        "samples": decisions.samples,
        "held_pairs": decisions.held,
        "num_inference_steps": decisions.steps,
        "seed": seed,
        "partition": env.unwrapped.mode_partition.to_dict(),  # type: ignore[attr-defined]
    }
    with staging_folder(root) as folder:
        features = _features(layout.dataset_features(), decisions) | ({} if watch is None else watch.features)
        dataset = _create_dataset(folder / "dataset", root.name, layout.fps, features)
        certified = CertificateWrapper(env, decisions, decision_interval=decisions.interval, held_pairs=decisions.held)
        watched = certified if watch is None else watch.wrap(certified, decisions)
        outcomes = []
        for episode in range(episodes):
            outcomes.append(_roll_out(watched, decisions, dataset, executed, seed + episode, watch))
            if outcomes[-1]["frames"]:
                dataset.save_episode()
            if progress is not None:
                progress(1)
        if not any(outcome["frames"] for outcome in outcomes):
            raise ValueError(
                f"every episode was refused before its first step, the first (seed {seed}) because "
                f"{outcomes[0]['refused']}: evaluate the policy in open loop, or train it further"
            )
        dataset.finalize()
        env.close()
        sidecar |= {"outcomes": outcomes, "policy": dict(provenance or {})}
        (folder / "dataset" / "meta" / "dualhead.json").write_text(json.dumps(sidecar, indent=2), encoding="utf-8")
        publish(folder / "dataset", root)
    loop = closed_loop_of(sidecar)
    assert loop is not None
    return loop, certified.certificate.verdict


def _features(demonstrated: Mapping[str, dict], decisions: Decider) -> dict[str, dict]:
    """LeRobotDataset features of rollouts, given those of demonstrations."""
    features = {key: feature for key, feature in demonstrated.items() if key.startswith(("observation.", "action"))}
    for head, dim in decisions.widths.items():
        shape = (decisions.samples * decisions.horizon * dim,)
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


def _roll_out(
    env: gym.Env, decisions: Decider, dataset: Any, executed: np.ndarray, seed: int, watch: RolloutWatch | None
) -> dict[str, Any]:
    """Run one episode and add its frames to the dataset; returns what became of it.

    A decision that the policy or the environment refuses ends the episode: its frames so far stay, but for the one
    whose step was refused.
    """
    outcome: dict[str, Any] = {
        "seed": seed,
        "success": False,
        "collision": False,
        "mode": -1,
        "frames": 0,
        "refused": None,
    }
    decisions.start(seed)
    try:
        observation, info = env.reset(seed=seed)
    except ValueError as error:
        return outcome | {"refused": _one_line(error)}
    decisions.observe(observation)
    done = False
    while not done:
        decided, certificate = info["coordination"]["decision"], certificate_columns(info)
        seen = {} if watch is None else watch.columns(info)
        predictions, action = decisions.predictions if decided else decisions.blank, decisions.chunk.pop(0)
        try:
            after, reward, terminated, truncated, info = env.step(action[executed])
        except ValueError as error:
            return outcome | {"refused": _one_line(error)}
        dataset.add_frame(
            {
                **{OBSERVATIONS[key]: observation[key] for key in OBSERVATIONS},
                "action": action,
                **predictions,
                "prediction.decision": np.array([decided]),
                **certificate,
                **seen,
                "next.reward": np.array([reward], dtype=np.float32),
                "next.success": np.array([bool(info["is_success"])]),
                "task": str(env.unwrapped.task_description),  # type: ignore[attr-defined]
            }
        )
        outcome |= {name: kind(info[key]) for name, key, kind in OUTCOME} | {"frames": outcome["frames"] + 1}
        # Robot environments say why an episode failed, and when its perturbation began.
        outcome |= {key: info[key] for key in ("failure", "onset") if key in info}
        decisions.observe(after)
        observation, done = after, terminated or truncated
    return outcome


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:LONGEST_REASON]
