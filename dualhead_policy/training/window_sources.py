"""Where training batches come from: a recorded split held in memory, or the ring's generator itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.dataset_frames import SplitFrames
from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.maps import REPRESENTATION_MAPS
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.training.array_store import ArrayStore
from dualhead_policy.training.window_order import WindowOrder


@dataclass(frozen=True)
class Batch:
    """Preprocessed observations (B, C), dual action windows (B, H, D) and clean tokens (B,) or None."""

    observation: Tensor
    action: Tensor
    token: Tensor | None


class WindowSource(Protocol):
    """Batches as a function of the training step."""

    def batch(self, step: int) -> Batch: ...


class RecordedWindows:
    """The windows of a recorded split, in the order in which ``lerobot-train`` would visit them.

    The whole split is preprocessed once. The order of an epoch is a function of (seed, epoch), by LeRobot's own
    sampler, and the last batch of an epoch is short, as there.

    Args:
        frames: The training split.
        policy: The policy to train (for its tokens and layout).
        preprocessor: Its preprocessor.
        batch_size: Windows in a batch.
        seed: Seed of the order.
    """

    def __init__(self, frames: SplitFrames, policy: DualheadPolicy, preprocessor: Any, batch_size: int, seed: int):
        config = policy.config
        device = policy.training_step.device
        ends = np.flatnonzero(np.diff(frames.episode_index, append=-1)) + 1
        self.order = WindowOrder(frames.episode_index, config.drop_n_last_frames, batch_size, seed)
        self._observation = _preprocess(preprocessor, policy, frames.observation)
        self._action = torch.from_numpy(frames.action).to(device)
        self._steps = torch.arange(config.chunk_size, device=device)
        self._last_frame = torch.from_numpy(np.repeat(ends - 1, np.diff(ends, prepend=0))).to(device)
        self._token: Tensor | None = None
        if config.token in ("oracle", "episode"):
            self._token = policy.episode_token[torch.from_numpy(frames.episode_index).to(device)]
        elif policy.model.tokens is not None:
            self._token = self._nearest_tokens(policy)

    def _nearest_tokens(self, policy: DualheadPolicy) -> Tensor:
        """Window tokens by the window's first frame; frames that begin no window keep token 0."""
        assert policy.model.tokens is not None
        position = self._action[:, policy.model.head_slices["position"]]
        token = torch.zeros(len(position), dtype=torch.int64, device=position.device)
        for part in self.order.frames.to(position.device).split(65_536):
            token[part] = policy.model.tokens.assign(position[self._windows(part)])
        return token

    def _windows(self, start: Tensor) -> Tensor:
        """Frames (B, H) of the windows that begin at ``start`` (B,); beyond its episode's end the last one repeats."""
        return torch.minimum(start[:, None] + self._steps, self._last_frame[start, None])

    def __len__(self) -> int:
        return len(self.order)

    def share(self, store: ArrayStore) -> None:
        """Hold the arrays in ``store``, where all runs of a machine find theirs; the order of visits stays its own."""
        for name in ("_observation", "_action", "_last_frame", "_token"):
            own = getattr(self, name)
            if own is not None:
                setattr(self, name, store.shared(own))

    def batch(self, step: int) -> Batch:
        """The batch of training step ``step``."""
        return self.windows(self.order.starts(step).to(self._action.device))

    def windows(self, start: Tensor) -> Batch:
        """The windows that begin at the frames ``start`` (B,), on the split's device."""
        return Batch(
            self._observation[start],
            self._action[self._windows(start)],
            None if self._token is None else self._token[start],
        )


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
        self._policy, self._preprocessor = policy, preprocessor
        self._batch_size, self._seed = batch_size, seed

    def batch(self, step: int) -> Batch:
        """The batch of training step ``step``."""
        rng = np.random.default_rng([self._seed, step])
        condition = self._generator.draw_conditions(rng, self._batch_size)
        mode = self._generator.draw_modes(rng, self._batch_size)
        path = self._generator.draw_paths(rng, condition, mode)
        action = np.concatenate([self._map.from_position(path), path], axis=-1).astype(np.float32)
        raw = {
            "observation.environment_state": condition.astype(np.float32),
            "observation.state": np.zeros((self._batch_size, 2), dtype=np.float32),
        }
        device = self._policy.training_step.device
        action = torch.from_numpy(action).to(device)
        token: Tensor | None = None
        if self._policy.config.token == "oracle":
            token = torch.from_numpy(mode).to(device)
        elif self._policy.model.tokens is not None:
            token = self._policy.model.tokens.assign(action[..., self._policy.model.head_slices["position"]])
        return Batch(_preprocess(self._preprocessor, self._policy, raw), action, token)


def _preprocess(preprocessor: Any, policy: DualheadPolicy, raw: dict[str, np.ndarray]) -> Tensor:
    batch = preprocessor({key: torch.from_numpy(raw[key]) for key in policy.observation_keys})
    return torch.cat([batch[key] for key in policy.observation_keys], dim=-1)
