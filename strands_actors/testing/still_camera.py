"""A camera without a device, so that the kill matrix can break a camera's process like any other process.

The settings of the camera name it as ``strands_actors.testing.still_camera:open_camera``.
"""

from __future__ import annotations

import time

import numpy as np

from strands_actors.contract.cameras import CameraSettings, Picture

WIDTH, HEIGHT = 32, 24
SETTINGS = {"type": f"{__name__}:open_camera", "fps": 5, "width": WIDTH, "height": HEIGHT}
"""For ``Robot(..., cameras={"eye": SETTINGS})``."""


class StillCamera:
    """A camera that returns the same picture again and again."""

    paced = False

    def __init__(self, settings: CameraSettings) -> None:
        self._image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    async def read(self) -> Picture:
        """Return the picture, with the present time as the time of its capture."""
        return Picture(self._image, time.monotonic_ns())

    async def aclose(self) -> None:
        """Do nothing, since there is no device to close."""


async def open_camera(settings: CameraSettings) -> StillCamera:
    """Return a camera of black pictures. It ignores the settings."""
    return StillCamera(settings)
