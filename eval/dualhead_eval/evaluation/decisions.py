"""Decisions of a policy in closed loop: several pairs of chunks each, of which the first is executed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import torch

from dualhead_envs.layout import Layout
from dualhead_policy.flow.coupling import require_shared_noise
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.representation import RepresentationLayout
from dualhead_policy.sampling import SamplingCoupling

#: Observations by LeRobot key, as the environments name them.
OBSERVATIONS = {"agent_pos": "observation.state", "environment_state": "observation.environment_state"}


def held_pairs(policy: DualheadPolicy) -> int:
    """Pairs of a decision that follow what the episode holds: 1 under oracle or episode tokens or a latent, else 0.

    A held pair is no draw of its own decision: under unequal priors it repeats the first decision's choice through the
    whole episode. What counts independent draws leaves it out.
    """
    holds_token = policy.model.tokens is not None and policy.config.token != "window"
    return int(holds_token or policy.model.shared_latent is not None)


class Decider(Protocol):
    """What decides in closed loop, and what a recording needs of it.

    Attributes:
        samples: Pairs of chunks per decision.
        horizon: Steps of a recorded chunk.
        interval: Actions executed before the next decision.
        held: Pairs of a decision that follow what the episode holds.
        steps: Denoising or integration steps of a sample.
        widths: Columns of predictions by name, with the dimensions of one step.
        predictions: The last decision's chunks, as the dataset's columns.
        blank: The same columns where nothing was decided.
        chunk: Actions of the last decision that are still to be executed.
    """

    samples: int
    horizon: int
    interval: int
    held: int
    steps: int
    widths: dict[str, int]
    predictions: dict[str, np.ndarray]
    blank: dict[str, np.ndarray]
    chunk: list[np.ndarray]

    def require_control(self, control: str) -> None:
        """Refuse a control that the policy cannot drive."""
        ...

    def require_layout(self, layout: Layout, env_id: str) -> None:
        """Refuse an environment of another layout."""
        ...

    def start(self, seed: int) -> None:
        """Begin an episode."""
        ...

    def observe(self, observation: Mapping[str, Any]) -> None:
        """See an observation, decision or not."""
        ...

    def __call__(self, observation: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Decide; returns the paths (n, H, d) of every pair in metres."""
        ...


class Decisions:
    """Samples both heads whenever it is called, and keeps what a rollout needs.

    Args:
        policy: The policy.
        preprocess: Its preprocessor.
        samples: Pairs of chunks per decision.
        coupling: What the heads share; None: as they were trained. The episode's token or latent stays the episode's.

    Raises:
        ValueError: If all of a decision's pairs would follow what the episode holds, or private noise is to be aligned.

    Attributes:
        generator: Source of all draws of one episode.
        predictions: The last decision's chunks, as the dataset's columns.
        blank: The same columns where nothing was decided.
        chunk: Dual actions of the last decision that are still to be executed.
    """

    def __init__(
        self,
        policy: DualheadPolicy,
        preprocess: Callable[[Any], Any],
        samples: int,
        coupling: SamplingCoupling | None = None,
    ) -> None:
        self.coupling = coupling or SamplingCoupling()
        require_shared_noise(self.coupling, policy.config.source_noise_beta)
        self.policy, self.preprocess, self.samples = policy, preprocess, samples
        self.horizon, self.interval = policy.config.chunk_size, policy.config.n_action_steps or 1
        self.held, self.steps = held_pairs(policy), policy.config.num_inference_steps
        self.widths = dict(policy.model.head_dims)
        if samples <= self.held:
            raise ValueError(
                f"samples={samples} leaves no fresh pair: the first pair of each decision follows the token or latent "
                f"that its episode holds; draw {self.held + 1} or more pairs per decision"
            )
        self.predictions: dict[str, np.ndarray] = {}
        self.chunk: list[np.ndarray] = []
        self.blank = {
            f"prediction.{head}": np.zeros(samples * policy.config.chunk_size * dim, dtype=np.float32)
            for head, dim in policy.model.head_dims.items()
        }

    def require_control(self, control: str) -> None:
        """Refuse the pose where the policy has no orientation head.

        Raises:
            ValueError: In one sentence.
        """
        if control == "pose" and "rotation" not in self.policy.model.head_dims:
            raise ValueError(
                "control='pose' executes the orientation head, which this policy lacks: choose 'joint' or 'position', "
                "or train with --policy.rotation_head=true"
            )

    def require_layout(self, layout: Layout, env_id: str) -> None:
        """Refuse an environment of another layout.

        Raises:
            ValueError: In one sentence about the difference.
        """
        expected = RepresentationLayout.from_names(layout.action_names)
        self.policy.representation.require_same(expected, owner="the policy", given=f"environment {env_id}")

    def observe(self, observation: Mapping[str, Any]) -> None:
        """A dual-head policy has no past."""

    def start(self, seed: int) -> None:
        """Begin an episode: its draws, and its token or latent."""
        self.policy.reset()
        self.generator = torch.Generator().manual_seed(seed)
        self.token: torch.Tensor | None = None
        self.latent: torch.Tensor | None = None

    def __call__(self, observation: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Decide: sample both heads, keep the chunk to execute, return both heads' paths (n, H, d) in metres.

        Raises:
            ValueError: If a chunk is not finite.
        """
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
        coupling = replace(self.coupling, token=token, latent=latent)
        drawn = policy.sample(batch, self.samples, coupling=coupling, generator=self.generator)
        for head in policy.model.head_dims:
            if not torch.isfinite(getattr(drawn, head)).all():
                raise ValueError(f"the {head} head predicted a number that is not finite")
        self.predictions = {
            f"prediction.{head}": getattr(drawn, head)[0].flatten().cpu().numpy() for head in policy.model.head_dims
        }
        self.chunk = list(policy.dual_chunk(drawn)[0, : policy.config.n_action_steps].cpu().numpy())
        joint = policy.model.kinematics.position(drawn.joint[0].double())
        return joint.cpu().numpy(), drawn.position[0].double().cpu().numpy()
