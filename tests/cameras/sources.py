"""Fake sources of pictures, which a camera's process opens.

A file with the path in ``view`` controls some of them from outside.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import trio

from strands_actors.contract.cameras import CameraSettings, Picture
from strands_actors.contract.wire import WireDown

SIZE = 48, 32


def picture(count: int, settings: CameraSettings) -> Picture:
    """Return a picture. Red is the number of the picture; blue is 200 in the upper left corner only."""
    width, height = settings.captured_size if settings.width else SIZE
    image = np.zeros((height, width, 3), np.uint8)
    image[:, :, 0] = count % 256
    image[0, 0, 2] = 200
    return Picture(image, time.monotonic_ns())


def _is_there(settings: CameraSettings) -> bool:
    return Path(settings.view).exists()


class Steady:
    """A source that gives pictures at the rate of the settings."""

    paced = False

    def __init__(self, settings: CameraSettings) -> None:
        self.settings = settings
        self.count = 0

    async def read(self) -> Picture:
        self.count += 1
        return picture(self.count, self.settings)

    async def aclose(self) -> None:
        pass


class Flood(Steady):
    """A source that gives pictures as fast as the processor allows."""

    paced = True


class Plugged(Steady):
    """A source that works only while its file exists."""

    async def read(self) -> Picture:
        if not _is_there(self.settings):
            raise WireDown("it was unplugged")
        return await super().read()


class Broken(Steady):
    """A source that raises after three pictures, as a user's own driver may."""

    async def read(self) -> Picture:
        if self.count >= 3:
            raise ZeroDivisionError("of a user's own code")
        return await super().read()


class Ahead(Steady):
    """A source that stamps its pictures by another clock."""

    async def read(self) -> Picture:
        seen = await super().read()
        return Picture(seen.image, time.time_ns())


class Wide(Steady):
    """A source that gives another size than the requested one."""

    async def read(self) -> Picture:
        image = np.zeros((40, 80, 3), np.uint8)
        return Picture(image, time.monotonic_ns())


async def steady(settings: CameraSettings) -> Steady:
    return Steady(settings)


async def flood(settings: CameraSettings) -> Steady:
    return Flood(settings)


async def plugged(settings: CameraSettings) -> Steady:
    if not _is_there(settings):
        raise WireDown("it is not plugged in")
    return Plugged(settings)


async def broken(settings: CameraSettings) -> Steady:
    return Broken(settings)


async def ahead(settings: CameraSettings) -> Steady:
    return Ahead(settings)


async def wide(settings: CameraSettings) -> Steady:
    return Wide(settings)


async def once(settings: CameraSettings) -> Steady:
    """Open a source that gives one picture, and then blocks for ever."""

    class Once(Steady):
        async def read(self) -> Picture:
            if self.count:
                await trio.sleep_forever()
            return await super().read()

    return Once(settings)
