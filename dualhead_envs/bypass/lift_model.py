"""robosuite's Lift scene with a Panda, as MJCF text, taken once per version and kept in the user's cache.

robosuite is asked in a process of its own: importing it sets ``MUJOCO_GL``, opens a GL library, prints notices and
draws from NumPy's global generator, none of which may happen to the caller.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from importlib.metadata import distribution, version
from pathlib import Path

from dualhead_envs.atomic_files import write_atomically

#: Run in a fresh interpreter; writes the MJCF to the path in argv[1].
_EXTRACT = """
import sys, types
private = types.ModuleType("robosuite.macros_private")
private.CONSOLE_LOGGING_LEVEL = "ERROR"
private.MUJOCO_GPU_RENDERING = False
sys.modules["robosuite.macros_private"] = private
from robosuite.environments.manipulation.lift import Lift
class ModelTaken(Exception):
    pass
class LiftModel(Lift):
    def _load_model(self):
        super()._load_model()
        with open(sys.argv[1], "w", encoding="utf-8") as file:
            file.write(self.model.get_xml())
        raise ModelTaken
try:
    LiftModel(robots="Panda", use_camera_obs=False, has_renderer=False, has_offscreen_renderer=False)
except ModelTaken:
    pass
"""


def cache_directory() -> Path:
    """Where compiled scenes are kept: ``$DUALHEAD_CACHE``, else ``$XDG_CACHE_HOME/dualhead``, else ~/.cache."""
    if root := os.environ.get("DUALHEAD_CACHE"):
        return Path(root)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dualhead"


def cache_key(*parts: str) -> str:
    """A short digest of ``parts`` and of everything else that the scene depends on.

    The MJCF names robosuite's meshes by absolute path, so the place of the installation is part of the key.
    """
    robosuite = distribution("robosuite")
    parts += (robosuite.version, str(robosuite.locate_file("robosuite")), version("mujoco"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def lift_mjcf() -> str:
    """The MJCF of robosuite's Lift with a Panda, without obstacle or goal.

    Raises:
        RuntimeError: If robosuite cannot build its model.
    """
    path = cache_directory() / f"lift-{cache_key(_EXTRACT)}.xml"
    if not path.exists():
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "lift.xml"
            environment = os.environ | {"MUJOCO_GL": "disable"}
            done = subprocess.run(
                [sys.executable, "-W", "ignore", "-c", _EXTRACT, str(target)],
                env=environment,
                capture_output=True,
                text=True,
            )
            if done.returncode or not target.exists():
                reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
                raise RuntimeError(
                    f"robosuite {version('robosuite')} did not build its Lift scene ({reason}): "
                    "reinstall robosuite==1.4.1"
                )
            mjcf = target.read_text(encoding="utf-8")
        with suppress(OSError):  # a read-only or full cache costs time, not the environment
            write_atomically(path, mjcf)
        return mjcf
    return path.read_text(encoding="utf-8")
