"""The flag marks where demonstrations part, with their modes or without."""

import numpy as np
import pytest

from dualhead_envs.dataset_frames import read_split
from dualhead_eval.monitor.branch_flag import BranchFlag


def branching(rng, frames=400):
    """Frames along a line: before 0 all go straight on, beyond they go up or down by mode."""
    x, mode = rng.uniform(-1, 1, frames), rng.integers(0, 2, frames)
    rise = np.where(x > 0, 0.2, 0.0) * (2 * mode - 1)
    rise = rise[:, None] * np.linspace(0, 1, 16) + 0.03 * rng.standard_normal((frames, 1)) * np.linspace(0, 1, 16)
    futures = np.stack([np.tile(x[:, None], 16), rise], axis=-1)
    return np.stack([x, np.full(frames, 7.0)], axis=1), futures, mode


@pytest.mark.parametrize("with_modes", [True, False])
def test_two_modes_are_open_where_the_futures_part(with_modes):
    frames, futures, modes = branching(np.random.default_rng(0))
    flag = BranchFlag(frames, futures, modes if with_modes else None)
    assert [flag(np.array([x, 7.0])) for x in (-0.9, -0.5, 0.5, 0.9)] == [False, False, True, True]
    assert not flag(np.array([np.nan, 7.0]))


def test_one_mode_alone_is_no_branch_and_too_few_frames_are_refused():
    frames, futures, modes = branching(np.random.default_rng(1))
    rare = np.where(np.arange(400) % 20 == 0, 1, 0)
    assert not BranchFlag(frames, futures * [1, 0], rare)(np.array([0.5, 7.0]))
    with pytest.raises(ValueError, match="at least 16"):
        BranchFlag(frames[:8], futures[:8], modes[:8])


def test_the_ring_is_open_at_its_centre(ring_data):
    """Every path of the ring begins at the origin and chooses its mode there."""
    split = read_split(ring_data / "train")
    flag = BranchFlag.from_split(split)
    start = int(np.flatnonzero(split.frame_index == 0)[0])
    here = np.concatenate([column[start] for column in split.observation.values()]).astype(float)
    assert isinstance(flag(here), bool)
