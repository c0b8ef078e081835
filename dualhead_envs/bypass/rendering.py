"""Pictures of a scene, through EGL or OSMesa, opened only when the first picture is asked for."""

from __future__ import annotations

import atexit
import ctypes
import os
import platform
import weakref
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from dualhead_envs.bypass.physics_engine import mujoco
from dualhead_envs.bypass.scene import GOAL_SITE, OBSTACLE_BODY, SHADOW_SITE, load_scene
from dualhead_envs.bypass.task import BypassTask
from dualhead_envs.ribbon import Ribbon, drawable

_LIBRARIES = {"egl": ("libEGL.so.1", "libEGL.so"), "osmesa": ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")}
_PACKAGES = {"egl": "libegl1 libegl-mesa0 libgl1-mesa-dri", "osmesa": "libosmesa6"}
_NEXT_STEP = (
    f"on Debian or Ubuntu `apt-get install {_PACKAGES['egl']}` and set MUJOCO_GL=egl, or "
    f"`apt-get install {_PACKAGES['osmesa']}` and set MUJOCO_GL=osmesa; without pictures no OpenGL is needed"
)

#: Radius of a ribbon of usual width (m), of a bead relative to it, and how much of its colour shines by itself.
_RIBBON_RADIUS, _BEAD, _GLOW = 0.0022, 1.7, 0.6
#: Objects of a picture at most: the scene has about a hundred, a pair of chunks 31.
_MOST_OBJECTS = 5000


def _is_installed(backend: str) -> bool:
    for library in _LIBRARIES[backend]:
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


def _backend() -> str:
    """The rendering library to use: what ``MUJOCO_GL`` names, else EGL, else OSMesa.

    Raises:
        RuntimeError: If there is none.
    """
    requested = os.environ.get("MUJOCO_GL", "").strip().lower()
    if requested in ("disable", "disabled", "off", "false", "0"):
        raise RuntimeError(f"MUJOCO_GL={requested} forbids rendering: unset it, or {_NEXT_STEP}")
    if platform.system() != "Linux":
        return "cgl" if platform.system() == "Darwin" else "glfw"
    if requested in ("glfw", "glx"):
        return "glfw"
    for backend in ("egl", "osmesa"):
        if requested in ("", backend) and _is_installed(backend):
            return backend
    if requested in _LIBRARIES:
        raise RuntimeError(
            f"MUJOCO_GL={requested} asks for {_LIBRARIES[requested][0]}, which is not on this machine: {_NEXT_STEP}"
        )
    raise RuntimeError(f"rendering needs EGL or OSMesa, and neither is on this machine: {_NEXT_STEP}")


def opengl() -> str:
    """The rendering library that pictures would use, or why there is none, in a few words."""
    try:
        return _backend()
    except RuntimeError as error:
        return f"none: {error}"


class SceneRenderer:
    """Renders one scene. Opens a GL context at construction (0.5 to 1 s) and holds its own copy of the scene.

    Args:
        task: Which scene.
        width, height: Size of the pictures in pixels.
        camera: Name of one of the scene's cameras, or None for a view made for the obstacle.

    Raises:
        RuntimeError: If no GL library can be used; the sentence says what to install.
        ValueError: If the scene has no such camera.
    """

    def __init__(self, task: BypassTask, width: int, height: int, camera: str | None) -> None:
        backend = _backend()
        self._model = load_scene(task, "visual")
        self._camera = _camera(self._model, camera)
        try:
            context_class: Any = import_module(f"mujoco.{backend}").GLContext
            self._context = context_class(width, height)
            self._context.make_current()
            self._model.vis.global_.offwidth, self._model.vis.global_.offheight = width, height
            self._renderer = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:
            raise RuntimeError(f"OpenGL through {backend} failed ({error}): {_NEXT_STEP}") from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._renderer)
        self._data = mujoco.MjData(self._model)
        self._scene = mujoco.MjvScene(self._model, maxgeom=_MOST_OBJECTS)
        # Half the time of a frame, and nothing that a viewer would miss.
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = (0, 1, 0, 0, 0, 0)
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        # A context that outlives its library complains at exit. Registered after the library's own exit handler,
        # this one runs before it.
        if not _open:
            atexit.register(_close_all)
        _open.add(self)

    def render(
        self, qpos: np.ndarray, obstacle: np.ndarray, goal: np.ndarray, ribbons: Sequence[Ribbon] = ()
    ) -> np.ndarray:
        """The scene at generalised positions ``qpos`` (16,), with obstacle and goal at (3,) m.

        Ribbons are objects of the scene: what stands before them hides them.

        Args:
            qpos: Generalised positions.
            obstacle: Centre of the obstacle.
            goal: Centre of the goal.
            ribbons: Paths (H, 3) m to draw too.

        Returns:
            RGB (height, width, 3) uint8.
        """
        self._context.make_current()
        self._model.body(OBSTACLE_BODY).pos[:] = obstacle
        for site in range(self._model.nsite):
            name = self._model.site(site).name
            if name in (GOAL_SITE, SHADOW_SITE):
                self._model.site_pos[site, :2] = (goal if name == GOAL_SITE else obstacle)[:2]
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        for ribbon in drawable(ribbons, 3):
            self._add(ribbon)
        mujoco.mjr_render(self._viewport, self._scene, self._renderer)
        picture = np.empty((self._viewport.height, self._viewport.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._viewport, self._renderer)
        return picture[::-1].copy()

    def _add(self, ribbon: Ribbon) -> None:
        """Append the ribbon's capsules, or beads, to the scene that was just built."""
        rgba = np.array([*(channel / 255 for channel in ribbon.color), ribbon.opacity], dtype=np.float32)
        radius = _RIBBON_RADIUS * ribbon.width
        points = ribbon.points.astype(np.float64)
        shape = mujoco.mjtGeom.mjGEOM_SPHERE if ribbon.beads else mujoco.mjtGeom.mjGEOM_CAPSULE
        size = np.full(3, _BEAD * radius if ribbon.beads else radius)
        for index in range(len(points) if ribbon.beads else len(points) - 1):
            if self._scene.ngeom == self._scene.maxgeom:
                raise ValueError(
                    f"the ribbons need more than the {self._scene.maxgeom} objects of a picture: draw fewer"
                )
            geom = self._scene.geoms[self._scene.ngeom]
            mujoco.mjv_initGeom(geom, shape, size, points[index], np.eye(3).ravel(), rgba)
            if not ribbon.beads:
                mujoco.mjv_connector(geom, shape, radius, points[index], points[index + 1])
            geom.category, geom.emission = mujoco.mjtCatBit.mjCAT_DECOR, _GLOW
            self._scene.ngeom += 1

    def close(self) -> None:
        """Give the GL context back."""
        if self in _open:
            _open.discard(self)
            self._context.make_current()
            self._renderer.free()
            self._context.free()


_open: weakref.WeakSet[SceneRenderer] = weakref.WeakSet()


def _close_all() -> None:
    for renderer in list(_open):
        renderer.close()


def _camera(model: mujoco.MjModel, name: str | None) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    if name is None:
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = (0.03, 0.0, 0.95)
        camera.distance, camera.azimuth, camera.elevation = 1.05, 190.0, -38.0
        return camera
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
    if index < 0:
        names = [model.camera(i).name for i in range(model.ncam)]
        raise ValueError(f"camera={name!r} is not in the scene: choose one of {names}, or None")
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, index
    return camera
