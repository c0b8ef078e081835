"""Demonstrations to LeRobotDatasets: scripted experts, atomic shards, one bulk assembly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

__all__ = ["record", "record_ring"]


def record(env_id: str, root: Path | str, **options: Any) -> Path:
    """Record demonstrations of ``env_id`` into ``root``; the options are those of the environment's recorder.

    See :func:`dualhead_envs.recording.ring_recorder.record_ring` and
    :func:`dualhead_envs.bypass.record.record_bypass`.

    Raises:
        ValueError: If the id is not one of this package's, and as the recorder says.
    """
    from dualhead_envs.registration import ENVIRONMENTS

    if env_id not in ENVIRONMENTS:
        raise ValueError(f"env_id={env_id!r} is unknown, expected one of {', '.join(ENVIRONMENTS)}")
    if env_id.startswith("RotatingRing-"):
        from dualhead_envs.recording.ring_recorder import record_ring

        return record_ring(env_id, root, **options)
    from dualhead_envs.bypass.record import record_bypass

    return record_bypass(env_id, root, **options)


def __getattr__(name: str) -> Any:
    if name == "record_ring":  # imported on demand: the command line's --help must not wait for Parquet
        from dualhead_envs.recording.ring_recorder import record_ring

        return record_ring
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
