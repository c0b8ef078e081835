"""The environment that a recorded dataset names, made anew."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym


def make_recorded(env_id: str, env_kwargs: Mapping[str, Any], source: str) -> gym.Env:
    """The environment of a recording.

    Args:
        env_id: Its registered id.
        env_kwargs: Its keyword arguments, as the recording's ``meta/dualhead.json`` has them.
        source: Where they were read, for errors.

    Raises:
        ValueError: If there is no such environment, or it does not take these arguments.
    """
    try:
        return gym.make(f"dualhead_envs:{env_id}", disable_env_checker=True, **env_kwargs)
    except (gym.error.Error, KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{source} names the environment {env_id!r} with arguments that it does not take ({reason}): record the "
            "dataset again with this version"
        ) from error
