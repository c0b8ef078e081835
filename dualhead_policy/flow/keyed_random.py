"""Randomness as a function of (seed, step): no generator's history matters.

Every training step can be reproduced alone, a resumed run continues exactly, and runs that train side by side
draw what each would have drawn alone.
"""

from __future__ import annotations

import hashlib

import torch


def keyed_generator(*key: int | str, device: torch.device | str = "cpu") -> torch.Generator:
    """A generator whose state depends on ``key`` alone.

    Args:
        key: What identifies the draw, for example ``(seed, step, "train")``.
        device: Device of the generator.
    """
    digest = hashlib.blake2b(repr(key).encode(), digest_size=8).digest()
    # manual_seed takes a signed 64-bit integer.
    return torch.Generator(device=device).manual_seed(int.from_bytes(digest, "big") >> 1)
