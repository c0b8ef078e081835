"""Chunks of actions drawn from any LeRobot policy: many draws of many conditions in one batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.utils import populate_queues
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_IMAGES
from torch import Tensor

from dualhead_policy.lerobot_policies.policy_types import POLICY_TYPES, PolicyType


class ChunkPolicy:
    """A LeRobot policy from which chunks are drawn, each with a queue of its own.

    Args:
        policy: The policy, in evaluation mode. Its ``n_action_steps`` is widened where it would cut its chunk to that;
            :attr:`executed_steps` keeps what it was.
        preprocess: Its preprocessor.
        postprocess: Its postprocessor, which brings actions back to physical units.
        policy_type: What its type takes; by default that of its configuration.

    Attributes:
        executed_steps: Actions that the policy executes of a chunk.

    Raises:
        ValueError: If the policy averages overlapping chunks, which belong to no single draw, or repeats actions.
    """

    def __init__(
        self,
        policy: PreTrainedPolicy,
        preprocess: Callable[[Any], Mapping[str, Any]],
        postprocess: Callable[[Any], Any],
        policy_type: PolicyType | None = None,
    ) -> None:
        self.policy, self.preprocess, self.postprocess = policy, preprocess, postprocess
        config: Any = policy.config
        self._type = policy_type or POLICY_TYPES.get(config.type, PolicyType())
        if getattr(config, "temporal_ensemble_coeff", None) is not None:
            raise ValueError(
                f"the policy has temporal_ensemble_coeff={config.temporal_ensemble_coeff}, so that what it executes is "
                "an average over several chunks, expected null: save it without, with n_action_steps as wanted"
            )
        if getattr(config, "n_action_repeats", 1) != 1:
            raise ValueError(
                f"the policy has n_action_repeats={config.n_action_repeats}, so that what it executes is not its plan, "
                "expected 1: save it so, with n_action_steps as wanted"
            )
        executed = getattr(config, "n_action_steps", None) or getattr(config, "action_chunk_size", None)
        self.executed_steps = 1 if executed is None else int(executed)
        if self._type.whole_chunk:
            config.n_action_steps = config.horizon - config.n_obs_steps + 1

    @property
    def name(self) -> str:
        """The policy's type, for example ``"diffusion"``."""
        return str(self.policy.config.type)

    @property
    def n_obs_steps(self) -> int:
        """Observations that a decision takes: the present one and those before it."""
        return int(self.policy.config.n_obs_steps)

    @property
    def observation_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of one observation by key, images among them."""
        return {key: tuple(feature.shape) for key, feature in (self.policy.config.input_features or {}).items()}

    @property
    def action_width(self) -> int:
        """Dimensions of an action."""
        feature = self.policy.config.action_feature
        assert feature is not None
        return int(feature.shape[0])

    @property
    def denoising_steps(self) -> int:
        """Denoising steps of a sample; 1 for a policy that makes it in one pass."""
        if self._type.steps_field is None:
            return 1
        steps = getattr(self.policy.config, self._type.steps_field)
        return int(steps if steps is not None else self.policy.config.num_train_timesteps)

    def use_denoising_steps(self, steps: int) -> None:
        """Make samples in ``steps`` denoising steps from now on.

        Raises:
            ValueError: If the policy has another number and no choice.
        """
        if steps == self.denoising_steps:
            return
        if self._type.steps_field != "num_inference_steps":
            raise ValueError(
                f"a policy of type {self.name!r} makes a sample in {self.denoising_steps} step, not {steps}: "
                "leave --nfe out"
            )
        limit = self.policy.config.num_train_timesteps
        if not 1 <= steps <= limit:
            raise ValueError(f"--nfe {steps} is not among the policy's 1 to {limit} denoising steps: give one of these")
        self.policy.config.num_inference_steps = steps
        self.policy.diffusion.num_inference_steps = steps

    def draw(self, history: Mapping[str, Tensor], draws: int, seed: int) -> Tensor:
        """Independent chunks for every condition.

        Args:
            history: Raw observations by key, each (B, ``n_obs_steps``, ...), the present one last.
            draws: Chunks N per condition.
            seed: Seed of all of them; the process's own random numbers are left as they were.

        Returns:
            Actions (B, N, H, D) in physical units, on the CPU: the whole chunk, from the present step on.
        """
        conditions = len(next(iter(history.values())))
        rows = torch.arange(conditions).repeat_interleave(draws)
        with torch.random.fork_rng(devices=_devices(self.policy)), torch.no_grad():
            torch.manual_seed(seed)
            parts = [
                self._chunk({key: value[part] for key, value in history.items()})
                for part in rows.split(self._type.batch_rows)
            ]
        return torch.cat(parts).reshape(conditions, draws, *parts[0].shape[1:])

    def _chunk(self, history: Mapping[str, Tensor]) -> Tensor:
        """One chunk (B, H, D) a row."""
        policy: Any = self.policy
        policy.reset()
        queues = getattr(policy, "_queues", None) or {}
        images = list(policy.config.image_features)
        batch: dict[str, Any] = {}
        for step in range(self.n_obs_steps):
            batch = dict(self.preprocess({key: value[:, step] for key, value in history.items()}))
            batch = {key: value for key, value in batch.items() if key in history}
            if images and OBS_IMAGES in queues:
                batch[OBS_IMAGES] = torch.stack([batch[key] for key in images], dim=-4)
            if images and OBS_IMAGE in queues:
                batch[OBS_IMAGE] = batch[images[0]]
            # As the policy's own select_action does, without deciding at every step of the past.
            populate_queues(queues, batch, exclude_keys=[ACTION])
        chunk = policy.select_action(batch)[:, None] if self._type.single_action else policy.predict_action_chunk(batch)
        chunk = chunk.transpose(0, 1) if self._type.time_first else chunk
        expected = (len(next(iter(history.values()))), self.action_width)
        if chunk.ndim != 3 or (len(chunk), chunk.shape[-1]) != expected:
            raise ValueError(
                f"a policy of type {self.name!r} predicts actions of shape {tuple(chunk.shape)}, expected "
                f"(B, H, D) with B = {expected[0]} rows and D = {expected[1]} dimensions: evaluate another type"
            )
        return self.postprocess(chunk).cpu().to(torch.float32)

    def is_deterministic(self, history: Mapping[str, Tensor]) -> bool:
        """Whether two draws with different seeds are the same, bit for bit."""
        few = {key: value[:2] for key, value in history.items()}
        return torch.equal(self.draw(few, 2, seed=0), self.draw(few, 2, seed=1))


def _devices(policy: PreTrainedPolicy) -> list[int]:
    device = next(policy.parameters()).device
    return [device.index or 0] if device.type == "cuda" else []
