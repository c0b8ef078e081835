"""Training batches from a recorded split held in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from dualhead_envs.dataset_frames import SplitFrames
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.training.array_store import ArrayStore
from dualhead_policy.training.batch import Batch
from dualhead_policy.training.observations import preprocessed
from dualhead_policy.training.window_order import WindowOrder


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
        self.order = WindowOrder(frames.episode_index, config.drop_n_last_frames, batch_size, seed)
        self.observation = preprocessed(preprocessor, policy, frames.observation)
        self.action = torch.from_numpy(frames.action).to(device)
        self.steps = torch.arange(config.chunk_size, device=device)
        last = np.searchsorted(frames.episode_index, frames.episode_index, side="right") - 1
        self.last_frame = torch.from_numpy(last).to(device)
        self.token: Tensor | None = None
        if config.token in ("oracle", "episode"):
            self.token = policy.episode_token[torch.from_numpy(frames.episode_index).to(device)]
        elif policy.model.tokens is not None:
            self.token = self._nearest_tokens(policy)

    def _nearest_tokens(self, policy: DualheadPolicy) -> Tensor:
        """Window tokens by the window's first frame; frames that begin no window keep token 0."""
        assert policy.model.tokens is not None
        position = self.action[:, policy.model.head_slices["position"]]
        token = torch.zeros(len(position), dtype=torch.int64, device=position.device)
        for part in self.order.frames.to(position.device).split(65_536):
            token[part] = policy.model.tokens.assign(position[self._windows(part)])
        return token

    def _windows(self, start: Tensor) -> Tensor:
        """Frames (B, H) of the windows that begin at ``start`` (B,); beyond its episode's end the last one repeats."""
        return torch.minimum(start[:, None] + self.steps, self.last_frame[start, None])

    def __len__(self) -> int:
        return len(self.order)

    def share(self, store: ArrayStore) -> None:
        """Hold the arrays in ``store``, where all runs of a machine find theirs; the order of visits stays its own."""
        for name in ("observation", "action", "last_frame", "token"):
            own = getattr(self, name)
            if own is not None:
                setattr(self, name, store.shared(own))

    def batch(self, step: int) -> Batch:
        """The batch of training step ``step``."""
        start = self.order.starts(step).to(self.action.device)
        return Batch(
            self.observation[start],
            self.action[self._windows(start)],
            None if self.token is None else self.token[start],
        )
