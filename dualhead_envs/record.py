"""Record demonstrations of any of this package's environments."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def record(env_id: str, root: Path | str, **options: Any) -> Path:
    """Record demonstrations of ``env_id`` into ``root``; the options are those of the environment's recorder.

    See :func:`dualhead_envs.ring.record.record_ring` and
    :func:`dualhead_envs.bypass.record.record_bypass`.

    Raises:
        ValueError: If the id is not one of this package's, and as the recorder says.
    """
    from dualhead_envs.registration import ENVIRONMENTS

    if env_id not in ENVIRONMENTS:
        raise ValueError(f"env_id={env_id!r} is unknown, expected one of {', '.join(ENVIRONMENTS)}")
    if env_id.startswith("RotatingRing-"):
        from dualhead_envs.ring.record import record_ring

        return record_ring(env_id, root, **options)
    from dualhead_envs.bypass.record import record_bypass

    return record_bypass(env_id, root, **options)
