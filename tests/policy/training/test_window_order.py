"""Windows are visited in the order of LeRobot's own sampler."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.sampler import EpisodeAwareSampler

from dualhead_policy.training.window_order import WindowOrder


@given(
    lengths=st.lists(st.integers(3, 9), min_size=1, max_size=6),
    dropped=st.integers(0, 2),
    batch=st.integers(1, 7),
    seed=st.integers(0, 2**31),
    epoch=st.integers(0, 40),
)
def test_an_epoch_is_that_of_lerobots_sampler(lengths, dropped, batch, seed, epoch):
    order = WindowOrder(np.repeat(np.arange(len(lengths)), lengths), dropped, batch, seed)
    ends = np.cumsum(lengths)
    theirs = EpisodeAwareSampler(
        (ends - lengths).tolist(), ends.tolist(), drop_n_last_frames=dropped, shuffle=True, seed=seed
    )
    theirs.set_epoch(epoch)
    steps = range(epoch * order.batches_per_epoch, (epoch + 1) * order.batches_per_epoch)
    batches = [order.starts(step) for step in steps]
    assert np.concatenate(batches).tolist() == list(theirs)
    assert order.frames.tolist() == theirs.indices
    assert [len(starts) for starts in batches] == [order.size(step) for step in steps]


def test_a_split_without_a_window_is_refused():
    with pytest.raises(ValueError, match="no episode has more than 15 frames"):
        WindowOrder(np.zeros(10, dtype=np.int64), 15, 4, 0)
