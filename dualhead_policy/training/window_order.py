"""The order in which a run visits the windows of its split: that of ``lerobot-train``, as a function of the step."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


class WindowOrder:
    """First frames of the windows of every step: shuffled anew every epoch, the last batch of an epoch short.

    The permutation is that of LeRobot's ``EpisodeAwareSampler``, which a test compares it with. That one maps every
    position to its frame in Python, four microseconds each; here an epoch is one lookup.

    Args:
        episode_index: Episode of every frame (F,), ascending.
        drop_n_last_frames: Frames at the end of an episode that begin no window.
        batch_size: Windows in a batch.
        seed: Seed of the order.

    Raises:
        ValueError: If no frame begins a window.
    """

    def __init__(self, episode_index: np.ndarray, drop_n_last_frames: int, batch_size: int, seed: int):
        last = np.searchsorted(episode_index, episode_index, side="right") - 1
        frame = np.arange(len(episode_index))
        self._frames = frame[frame + drop_n_last_frames <= last]
        if not len(self._frames):
            raise ValueError(
                f"no episode has more than {drop_n_last_frames} frames, the last of which begin no window: record "
                "longer episodes, or raise policy.padded_steps"
            )
        self.batch_size, self._seed = batch_size, seed
        self.batches_per_epoch = -(-len(self._frames) // batch_size)
        self._epoch = -1
        self._order = self._frames

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def frames(self) -> Tensor:
        """First frame of every window (N,), ascending."""
        return torch.from_numpy(self._frames)

    def size(self, step: int) -> int:
        """Windows in the batch of training step ``step``."""
        offset = step % self.batches_per_epoch
        return min(self.batch_size, len(self._frames) - offset * self.batch_size)

    def starts(self, step: int) -> Tensor:
        """First frames (B,) of the windows of training step ``step``."""
        epoch, offset = divmod(step, self.batches_per_epoch)
        if epoch != self._epoch:
            seed = int(np.random.SeedSequence([self._seed, epoch]).generate_state(1, dtype=np.uint64)[0])
            permutation = torch.randperm(len(self._frames), generator=torch.Generator().manual_seed(seed))
            self._order, self._epoch = self._frames[permutation.numpy()], epoch
        return torch.from_numpy(self._order[offset * self.batch_size : (offset + 1) * self.batch_size])
