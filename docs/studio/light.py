"""Draw a scene as in a studio: a soft lamp, light from the whole ceiling, and a plain floor.

MuJoCo's shadows and outlines have hard edges. So a picture is the mean of several, each with the lamps and the
camera at slightly other places.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control.renderer import SceneRenderer
from strands_actors.drivers.common.simulation_control.scene import View

from .camera import LENS_DEG, Floats

KEY = np.array([-0.45, 0.55, -0.9])
"""Direction of the lamp's light, for a camera that looks in the direction ``AZIMUTH``."""
AZIMUTH = 140.0
SOFTNESS = 0.16
"""Size of the lamp, as the spread of its direction."""

FLOOR = (0.855, 0.868, 0.884)
BACKDROP = (0.93, 0.942, 0.96)
"""Colour of the sky: that of the floor in full light, so that no horizon shows."""

FOG = 6.0, 10.0
"""Where the floor begins to fade into the sky, and where it has, as multiples of the robot's size."""

SHADOW_PIXELS = 4096
SHADOW_CLIP = 10.0
"""Reach of the shadows, as a multiple of the robot's size. At its end MuJoCo draws speckles on the floor."""


class Studio:
    """A scene in which one robot is drawn. Close it after use."""

    def __init__(self, file: bytes, width: int, height: int, samples: int) -> None:
        """Open the scene.

        Args:
            file: The scene, as a binary file of MuJoCo.
            width: Width of the pictures in pixels.
            height: Height of the pictures in pixels.
            samples: Number of pictures of which one is the mean.
        """
        self.model: Any = mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": file})
        self._size = width, height
        _furnish(self.model)
        view = View(tuple(self.model.stat.center), self.model.stat.extent)
        self._renderer = SceneRenderer(self.model, view, width, height)
        self._renderer.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        self._lamps = _lamps(samples)
        self._shifts = np.random.default_rng(2).uniform(-0.5, 0.5, (samples, 2))

    def shoot(self, pose: Sequence[float], eye: Any) -> NDArray[np.uint8]:
        """Return a picture of shape (height, width, 3), as seen by an ``MjvCamera``."""
        width, height = self._size
        total = np.zeros((height, width, 3))
        lookat = eye.lookat.copy()
        for lamps, shift in zip(self._lamps, self._shifts, strict=True):
            self._point(lamps, np.radians(eye.azimuth - AZIMUTH))
            eye.lookat[:] = lookat + _moved(eye, shift, height)
            rows = self._renderer.shoot_from(eye, pose, width, height)
            total += np.frombuffer(rows, np.uint8).reshape(height, width, 3)
        eye.lookat[:] = lookat
        return (total / len(self._lamps)).round().astype(np.uint8)

    def _point(self, directions: Sequence[Floats], turn: float) -> None:
        """Let the lamps shine in these directions, turned about the vertical, so that they turn with the camera."""
        middle, far = self.model.stat.center, self.model.stat.extent * 5
        cos, sin = np.cos(turn), np.sin(turn)
        for lamp, (x, y, z) in enumerate(directions):
            direction = np.array([cos * x - sin * y, sin * x + cos * y, z])
            self.model.light_dir[lamp], self.model.light_pos[lamp] = direction, middle - direction * far

    def close(self) -> None:
        self._renderer.close()


def _furnish(model: Any) -> None:
    """Give the scene a plain floor, the studio's lamps, and a long lens."""
    model.vis.quality.offsamples = 0
    model.vis.quality.shadowsize = SHADOW_PIXELS
    model.vis.map.shadowclip = SHADOW_CLIP
    model.vis.global_.fovy = LENS_DEG
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = (*FLOOR, 1.0)
    for texture in range(model.ntex):
        if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            start = model.tex_adr[texture]
            count = model.tex_width[texture] * model.tex_height[texture] * model.tex_nchannel[texture]
            model.tex_data[start : start + count].reshape(-1, 3)[:] = np.array(BACKDROP) * 255
    model.vis.rgba.haze[:3] = model.vis.rgba.fog[:3] = BACKDROP
    model.vis.map.fogstart, model.vis.map.fogend = FOG
    model.vis.headlight.ambient[:] = 0.30
    model.vis.headlight.diffuse[:] = 0.16
    model.light_castshadow[:2] = True
    model.light_diffuse[0] = 0.55
    model.light_diffuse[1] = 0.48
    model.light_specular[0] = 0.35
    model.light_specular[1] = 0.0


def _moved(eye: Any, shift: Floats, height: int) -> Floats:
    """Return the vector that moves the picture of a camera by a part of a pixel: right and up."""
    turn, rise = np.radians(eye.azimuth), np.radians(eye.elevation)
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    up = np.array([-np.sin(rise) * np.cos(turn), -np.sin(rise) * np.sin(turn), np.cos(rise)])
    pixel_m = 2 * eye.distance * np.tan(np.radians(LENS_DEG) / 2) / height
    moved: Floats = (right * shift[0] + up * shift[1]) * pixel_m
    return moved


def _lamps(count: int) -> list[tuple[Floats, Floats]]:
    """Return pairs of directions: of the lamp's light, and of the light from a point of the ceiling."""
    numbers = np.random.default_rng(1)
    key = KEY / np.linalg.norm(KEY)
    pairs = []
    for index in range(count):
        soft = key + numbers.normal(0.0, SOFTNESS / 2, 3)
        # Points of a spiral cover the ceiling evenly.
        height = 1 - 0.65 * (index + 0.5) / count
        turn = index * 2.399963
        flat = np.sqrt(1 - height**2)
        ceiling = -np.array([flat * np.cos(turn), flat * np.sin(turn), height])
        pairs.append((soft / np.linalg.norm(soft), ceiling))
    return pairs
