"""The table of environment ids and its registration with Gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

#: Every id of this package with the arguments of :func:`gymnasium.register`. Entry points are strings, so
#: that nothing is imported before it is made.
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    f"RotatingRing-v{n_modes}": {
        "entry_point": "dualhead_envs.ring.env:rotating_ring",
        "vector_entry_point": "dualhead_envs.ring.vector_env:RotatingRingVectorEnv",
        "max_episode_steps": 16,
        "kwargs": {"n_modes": n_modes},
    }
    for n_modes in (2, 3, 4, 8)
} | {
    "BimodalBypass-v2": {
        "entry_point": "dualhead_envs.bypass.bimodal:bimodal_bypass",
        "max_episode_steps": 300,
    },
    "RotatingBypass-v3": {
        "entry_point": "dualhead_envs.bypass.rotating:rotating_bypass",
        "max_episode_steps": 300,
    },
}


def register_environments() -> None:
    """Register every environment of :data:`ENVIRONMENTS` that is not registered yet.

    The number in ``RotatingRing-v4`` is the number of modes, not a revision. Gymnasium would call all but
    the largest "out of date"; a specification whose name is its whole id has no revision to be out of date.
    """
    for env_id, arguments in ENVIRONMENTS.items():
        if env_id not in gym.registry:
            gym.register(id=env_id, **arguments)
        if env_id.startswith("RotatingRing-"):
            spec = gym.registry[env_id]
            spec.name, spec.version = env_id, None
