"""Batches drawn from the ring's generator itself."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.maps import REPRESENTATION_MAPS
from dualhead_policy.training.batch import Batch
from dualhead_policy.training.observations import preprocessed

if TYPE_CHECKING:
    from dualhead_policy.modeling_dualhead import DualheadPolicy


class FreshRingPaths:
    """Paths drawn from the ring's generator at every step: no path is ever seen twice.

    Args:
        env_kwargs: Keyword arguments of the ring environment that the split was recorded from.
        n_modes: Number of modes.
        policy: The policy to train.
        preprocessor: Its preprocessor, with the recorded split's statistics.
        batch_size: Paths in a batch.
        seed: The paths of a step are a function of (seed, step).

    Raises:
        ValueError: If the policy follows an episode token.
    """

    def __init__(
        self,
        env_kwargs: dict[str, Any],
        n_modes: int,
        policy: DualheadPolicy,
        preprocessor: Any,
        batch_size: int,
        seed: int,
    ):
        self._generator = RingGenerator(
            n_modes,
            env_kwargs.get("mode_probabilities"),
            env_kwargs.get("mode_angles"),
            **({"path_spread": env_kwargs["path_spread"]} if "path_spread" in env_kwargs else {}),
        )
        self._map = REPRESENTATION_MAPS[policy.representation.ring_map or ""]
        if policy.config.token == "episode":
            raise ValueError(
                "--fresh_paths has no recorded episodes to follow an episode token in: leave it out, or use "
                "policy.token=window"
            )
        self._scale = _ObservationScale(preprocessor, policy)
        self._device = policy.training_step.device
        self._oracle = policy.config.token == "oracle"
        self._tokens = None if policy.model.tokens is None else copy.deepcopy(policy.model.tokens).cpu()
        self._position = policy.model.head_slices["position"]
        self.batch_size, self._seed = batch_size, seed

    def batch(self, step: int) -> Batch:
        """The batch of training step ``step``."""
        drawn = self.drawn(step)
        token = None if drawn.token is None else drawn.token.to(self._device)
        return Batch(drawn.observation.to(self._device), drawn.action.to(self._device), token)

    def size(self, step: int) -> int:
        """Paths in the batch of training step ``step``: always the same."""
        return self.batch_size

    def drawn(self, step: int) -> Batch:
        """The batch of training step ``step`` on the CPU, where it is drawn."""
        rng = np.random.default_rng([self._seed, step])
        condition = self._generator.draw_conditions(rng, self.batch_size)
        mode = self._generator.draw_modes(rng, self.batch_size)
        path = self._generator.draw_paths(rng, condition, mode)
        action = np.concatenate([self._map.from_position(path), path], axis=-1).astype(np.float32)
        raw = {
            "observation.environment_state": torch.from_numpy(condition.astype(np.float32)),
            "observation.state": torch.zeros(self.batch_size, 2),
        }
        windows = torch.from_numpy(action)
        token: Tensor | None = None
        if self._oracle:
            token = torch.from_numpy(mode)
        elif self._tokens is not None:
            token = self._tokens.assign(windows[..., self._position])
        return Batch(self._scale(raw), windows, token)


class _ObservationScale:
    """The preprocessor's map of observations, which is affine in every dimension, as two rows of numbers.

    LeRobot's pipeline takes half a millisecond per call, five times what drawing a batch does, and is tied to a device.
    """

    def __init__(self, preprocessor: Any, policy: DualheadPolicy):
        self._keys = policy.observation_keys
        widths = {key: policy.config.input_features[key].shape[0] for key in self._keys}
        at = [
            preprocessed(preprocessor, policy, {key: np.full((1, n), value, np.float32) for key, n in widths.items()})
            for value in (0, 1)
        ]
        self._shift = at[0].cpu()
        self._slope = at[1].cpu() - self._shift

    def __call__(self, raw: dict[str, Tensor]) -> Tensor:
        return torch.addcmul(self._shift, torch.cat([raw[key] for key in self._keys], dim=-1), self._slope)
