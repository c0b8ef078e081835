"""Randomness as a function of (seed, step): no generator's history matters.

Every training step can be reproduced alone, a resumed run continues exactly, and runs that train side by side
draw what each would have drawn alone.
"""

from __future__ import annotations

import hashlib

import torch


def step_key(seed: int, step: int, purpose: str, rank: int = 0) -> tuple[int | str, ...]:
    """The key of a training step's draws: every process of a distributed training makes its own."""
    return (seed, step, purpose) if rank == 0 else (seed, step, purpose, "rank", rank)


def keyed_generator(*key: int | str) -> torch.Generator:
    """A generator on the CPU whose state depends on ``key`` alone.

    Args:
        key: What identifies the draw, for example ``(seed, step, "train")``.
    """
    digest = hashlib.blake2b(repr(key).encode(), digest_size=8).digest()
    # manual_seed takes a signed 64-bit integer.
    return torch.Generator().manual_seed(int.from_bytes(digest, "big") >> 1)
