"""A camera without a device, for the kill matrix: its process is a victim like any other.

A camera's settings name it as ``strands_actors.testing.still_camera:open_camera``.
"""

from __future__ import annotations

import time

import numpy as np

from strands_actors.contract.cameras import CameraSettings, Picture

WIDTH, HEIGHT = 32, 24
SETTINGS = {"type": f"{__name__}:open_camera", "fps": 5, "width": WIDTH, "height": HEIGHT}
"""For ``Robot(..., cameras={"eye": SETTINGS})``."""


class StillCamera:
    """Gives the same picture again and again."""

    paced = False

    def __init__(self, settings: CameraSettings) -> None:
        self._image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    async def read(self) -> Picture:
        """Return the picture, with the present time."""
        return Picture(self._image, time.monotonic_ns())

    async def aclose(self) -> None:
        """Do nothing: nothing is open."""


async def open_camera(settings: CameraSettings) -> StillCamera:
    """Return a camera of black pictures. It ignores the settings."""
    return StillCamera(settings)
