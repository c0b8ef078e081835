"""MuJoCo, imported so that state-only work never depends on an OpenGL library.

With ``MUJOCO_GL=egl`` and no libEGL on the machine, ``import mujoco`` itself fails ("'NoneType' object has no
attribute 'eglQueryString'"). Physics needs no OpenGL: here the import is then repeated without it, and only
rendering reports what is missing (:mod:`dualhead_envs.bypass.rendering`).
"""

from __future__ import annotations

import os

try:
    import mujoco
except (AttributeError, ImportError, RuntimeError):
    _requested = os.environ.get("MUJOCO_GL")
    if _requested is None:
        raise
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco
    finally:
        os.environ["MUJOCO_GL"] = _requested

__all__ = ["mujoco"]
