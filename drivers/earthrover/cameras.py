"""Pictures of the rover's cameras, asked of the service past the robot's tree: by a camera's process
(``cameras={"front": {}}``), or by whoever wants one.

They are larger than what actors tell each other, and nothing about them moves the robot.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import trio

from strands_actors.contract import cameras as contract
from strands_actors.contract.extras import missing
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.http_port import HttpPort
from strands_actors.drivers.common.malformed import MalformedFrame

from .driver import EarthRover
from .protocol import NOT_FOUND, OK, PICTURES, Picture, decode_picture

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

__all__ = ["open_camera", "picture", "take_picture"]

PICTURE_S = 2.0
"""Within which a picture must come, and a new one after the last."""
PICTURE_SIZE = 4 << 20
"""Bytes of an answer: a JPEG in base64."""
AGAIN_S = 0.02
"""Before it is asked again for a picture that has not changed."""


async def picture(port: str, view: str = "front") -> Picture:
    """Return what a camera sees now: ``front`` or ``rear``, of the service at ``port``. Raise
    ``ValueError`` for another name, ``WireDown`` when there is no picture."""
    if view not in PICTURES:
        raise ValueError(f"picture: no camera {view!r}. Use {' or '.join(PICTURES)}")
    client = _client(port)
    try:
        return await _ask(client, view)
    finally:
        client.close()


def take_picture(port: str, view: str = "front") -> Picture:
    """As ``picture``, for a script that runs no trio loop."""
    return trio.run(picture, port, view)


class RoverCamera:
    """One camera of the rover, asked again and again on one connection."""

    paced = False

    def __init__(self, client: HttpPort, view: str) -> None:
        self._client = client
        self._view = view
        self._stamp_s: float | None = None  # None: none was told yet

    async def read(self) -> contract.Picture:
        """A picture that is not the last one. It was taken when it was asked for, or before: the
        rover's clock is not ours. The first shows nothing: a service that has stopped gives its last
        one for ever, and who opens it anew would take that for a new one."""
        with trio.move_on_after(PICTURE_S):
            while True:
                asked_ns = time.monotonic_ns()
                told = await _ask(self._client, self._view)
                before_s, self._stamp_s = self._stamp_s, told.stamp_s
                if math.isnan(told.stamp_s) or (before_s is not None and told.stamp_s != before_s):
                    return contract.Picture(await trio.to_thread.run_sync(_pixels, told.jpeg), asked_ns)
                await trio.sleep(AGAIN_S)
        raise WireDown(f"picture: the {self._view} camera gives the same one again. Look at the SDK process")

    async def aclose(self) -> None:
        self._client.close()


async def open_camera(settings: contract.CameraSettings) -> RoverCamera:
    """Raise ``WireDown`` without what decodes pictures."""
    if why := missing("cameras", "a picture of the rover"):
        raise WireDown(why)
    return RoverCamera(_client(settings.port), settings.view)


def _client(port: str) -> HttpPort:
    return HttpPort(*EarthRover("earthrover", port, {}).config.address(), max_body=PICTURE_SIZE)


async def _ask(client: HttpPort, view: str) -> Picture:
    """Raise ``WireDown``."""
    answer = await client.ask("GET", PICTURES[view], within_s=PICTURE_S)
    if answer.status == NOT_FOUND:
        raise WireDown(f"picture: this rover has no {view} camera")
    if answer.status != OK:
        raise WireDown(f"picture: status {answer.status}. Look at the SDK process")
    try:
        return decode_picture(answer.body, view)
    except MalformedFrame as malformed:
        raise WireDown(f"picture: {malformed}. Look at the SDK process") from None


def _pixels(jpeg: bytes) -> NDArray[numpy.uint8]:
    import cv2
    import numpy

    image = cv2.imdecode(numpy.frombuffer(jpeg, numpy.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise WireDown("picture: it is no JPEG that can be decoded. Look at the SDK process")
    rgb: NDArray[numpy.uint8] = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return rgb
