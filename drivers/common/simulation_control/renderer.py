"""Draw pictures of a MuJoCo model, without a window."""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import trio

from strands_actors.contract.extras import missing
from strands_actors.drivers.common.physics.lean_mujoco import mujoco

from .scene import CAMERAS, MAX_HEIGHT, MAX_WIDTH, View, decorate, look, view_of, widened

LIBRARIES = {
    "egl": (("libEGL.so.1",), "libegl1"),
    "osmesa": (("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"), "libosmesa6"),
}
"""Platforms of OpenGL that need no window, in the order in which they are tried: names of the library,
and its Debian package."""

WINDOWED = ("", "enable", "enabled", "on", "true", "1", "glfw", "glx", "cgl")
"""Values of ``MUJOCO_GL`` with which this module chooses the platform."""


class CannotRender(Exception):
    """No picture can be taken. The exception's text gives the reason and the remedy."""


class Renderer:
    """Draw pictures of a separate copy of the simulated robot's model, one after the other, in a worker thread."""

    def __init__(self, spec: Any) -> None:
        self._spec = spec
        self._limiter = trio.CapacityLimiter(1)
        self._view: View | None = None
        self._drawn: SceneRenderer | None = None
        self._stale = False
        self._binary: tuple[int, bytes] | None = None
        self.scene = 0
        """Number of the present model; each ``exchange`` adds 1."""

    async def render(self, pose: Sequence[float], width: int, height: int, camera: str) -> bytes:
        """Return a picture: its rows from top to bottom, three bytes per pixel. Raise ``CannotRender``."""
        if not (1 <= width <= MAX_WIDTH and 1 <= height <= MAX_HEIGHT):
            raise CannotRender(
                f"a picture of {width} x {height} pixels. Ask for at most {MAX_WIDTH} x {MAX_HEIGHT}"
            )
        return await trio.to_thread.run_sync(self._render, pose, width, height, camera, limiter=self._limiter)

    async def model(self, pose: Sequence[float]) -> tuple[int, bytes]:
        """Return the number of the scene (it increases with each change of the model), and the scene as a binary
        file of MuJoCo.

        The file is kept for the next call, because making it delays the rest of this process by a tenth of a
        second.
        """
        while self._binary is None or self._binary[0] != self.scene:
            scene = self.scene
            self._binary = scene, await trio.to_thread.run_sync(self._save, pose, limiter=self._limiter)
        return self._binary

    def exchange(self, spec: Any) -> None:
        """Use the model ``spec`` from the next picture on. The caller must not use it any more, because a worker
        thread does."""
        self._spec = spec
        self._stale = True
        self.scene += 1

    def close(self) -> None:
        if self._drawn is not None:
            self._drawn.close()

    def _render(self, pose: Sequence[float], width: int, height: int, camera: str) -> bytes:
        if self._stale:
            self._stale, self._view = False, None
            self.close()
            self._drawn = None
        if self._drawn is not None and not self._drawn.holds(width, height):
            self._drawn.close()
            self._drawn = None
        if self._drawn is None:
            view = self._look(pose)
            self._drawn = SceneRenderer(decorate(self._spec, view).compile(), view, width, height)
        return self._drawn.shoot(pose, width, height, camera)

    def _look(self, pose: Sequence[float]) -> View:
        """Return the part of the scene that the camera shows. It is computed from the first pose, and then kept."""
        if self._view is None:
            model = self._spec.copy().compile()
            data = mujoco.MjData(model)
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            self._view = view_of(model, data)
        return self._view

    def _save(self, pose: Sequence[float]) -> bytes:
        model = decorate(self._spec, self._look(pose)).compile()
        file = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, file)
        return file.tobytes()


def plain(model: Any) -> Any:
    """Switch off shadows, reflections and smooth edges of a model, so that it is drawn five times as fast. The
    model is changed and returned."""
    model.vis.quality.shadowsize = model.vis.quality.offsamples = 0
    return model


class SceneRenderer:
    """A MuJoCo scene with its OpenGL context. Any thread may use it, but only one at a time."""

    def __init__(self, model: Any, view: View, width: int, height: int) -> None:
        """Create the OpenGL context.

        Args:
            model: A compiled model from ``decorate``.
            view: The part of the scene that the camera shows.
            width: Largest width of a picture in pixels.
            height: Largest height of a picture in pixels.

        Raises:
            CannotRender: OpenGL is not available.
        """
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        self._size = width, height
        self._model = model
        self._data = mujoco.MjData(model)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        fine = model.vis.quality.shadowsize > 0
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = fine
        self._option = mujoco.MjvOption()
        self._view = view
        self._gl = open_gl(width, height)
        with self._gl.as_current():
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    @property
    def flags(self) -> Any:
        """What is drawn beside the shapes, by ``mjtRndFlag``: shadows, reflections, fog and others. It can be
        changed."""
        return self._scene.flags

    def holds(self, width: int, height: int) -> bool:
        return width <= self._size[0] and height <= self._size[1]

    def shoot(self, pose: Sequence[float], width: int, height: int, camera: str) -> bytes:
        """Return a picture: its rows from top to bottom, three bytes per pixel. Raise ``CannotRender`` if there is
        no such camera."""
        model, data = self._model, self._data
        own = [model.camera(index).name for index in range(model.ncam)]
        if camera not in CAMERAS and camera not in own:
            names = ", ".join(name for name in dict.fromkeys((*CAMERAS, *own)) if name)
            raise CannotRender(f"no camera {camera!r}. There are {names}, and None for the whole robot")
        self._move(pose)
        self._view = widened(self._view, model, data)
        eye = mujoco.MjvCamera()
        # If a camera of the scene has the name of one of ``CAMERAS``, the scene's camera is used.
        if camera and camera in own:
            eye.type = mujoco.mjtCamera.mjCAMERA_FIXED
            eye.fixedcamid = model.camera(camera).id
        else:
            look(eye, model, self._view, width, height, camera)
        return self._draw(eye, width, height)

    def shoot_from(self, eye: Any, pose: Sequence[float], width: int, height: int) -> bytes:
        """Return a picture as ``shoot`` does, as seen by an ``MjvCamera``."""
        self._move(pose)
        return self._draw(eye, width, height)

    def _move(self, pose: Sequence[float]) -> None:
        self._data.qpos[:] = pose
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def _draw(self, eye: Any, width: int, height: int) -> bytes:
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, eye, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        rectangle = mujoco.MjrRect(0, 0, width, height)
        rows = np.empty((height, width, 3), np.uint8)
        with self._gl.as_current():
            mujoco.mjr_render(rectangle, self._scene, self._context)
            mujoco.mjr_readPixels(rows, None, rectangle, self._context)
        # OpenGL's first row is the lowest, so reverse the rows.
        return rows[::-1].tobytes()

    def close(self) -> None:
        with self._gl.as_current():
            self._context.free()
        self._gl.free()


def open_gl(width: int, height: int) -> Any:
    """Return an OpenGL context. ``MUJOCO_GL`` selects the platform; the default is the first available one. Raise
    ``CannotRender``."""
    if reason := missing("pictures", "a picture"):
        raise CannotRender(reason)
    requested = os.environ.get("MUJOCO_GL", "").strip().lower()
    if sys.platform == "darwin":
        platform = "cgl"
    elif requested in WINDOWED:
        platform = _first()
    elif requested in LIBRARIES:
        platform = requested
        if not _is_installed(platform):
            raise CannotRender(_missing([platform]))
    else:
        raise CannotRender(f"MUJOCO_GL is {requested!r}. Unset it, or use {_names(list(LIBRARIES))}")
    # MuJoCo reads this variable when it loads OpenGL.
    os.environ["MUJOCO_GL"] = platform
    try:
        return importlib.import_module(f"mujoco.{platform}").GLContext(width, height)
    # OpenGL libraries may raise any type of exception.
    except Exception as error:
        others = [name for name in LIBRARIES if name != platform]
        raise CannotRender(
            f"{platform} gives no context ({error}). Check the graphics driver, or use {_names(others)}"
        ) from error


def _first() -> str:
    for platform in LIBRARIES:
        if _is_installed(platform):
            return platform
    raise CannotRender(_missing(list(LIBRARIES)))


def _is_installed(platform: str) -> bool:
    for name in LIBRARIES[platform][0]:
        try:
            library = ctypes.CDLL(name)
        except OSError:
            continue
        return platform != "egl" or _devices(library) > 0
    return False


def _devices(egl: ctypes.CDLL) -> int:
    """Return the number of devices on which EGL can draw; 0 if EGL has no driver."""
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    if not address:
        return 0
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int))(address)
    count = ctypes.c_int()
    return count.value if query(0, None, ctypes.byref(count)) else 0


def _names(platforms: list[str]) -> str:
    return " or ".join(f"MUJOCO_GL={name} (Debian package {LIBRARIES[name][1]})" for name in platforms)


def _missing(platforms: list[str]) -> str:
    packages = " or ".join(f"{LIBRARIES[name][1]} ({name})" for name in platforms)
    return f"no OpenGL that draws without a window. Install {packages}: apt install {LIBRARIES[platforms[0]][1]}"
