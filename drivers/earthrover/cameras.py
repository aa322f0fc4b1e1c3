"""Read pictures of the rover's cameras from the service, outside the robot's tree. A camera process
(``cameras={"front": {}}``) uses this, and any program may.

Pictures are larger than messages between actors, and no request for one moves the robot.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import trio

from strands_actors.contract import cameras as contract
from strands_actors.contract.extras import missing
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.http_port import HttpPort

from .driver import EarthRover
from .protocol import NOT_FOUND, OK, PICTURES, Picture, decode_picture

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

__all__ = ["open_camera", "picture", "take_picture"]

PICTURE_S = 2.0
"""Longest time for a picture, and for a new one after the last."""
PICTURE_SIZE = 4 << 20
"""Largest answer in bytes: a JPEG in base64."""
AGAIN_S = 0.02
"""Pause before the next request if the picture has not changed."""


async def picture(port: str, view: str = "front") -> Picture:
    """Return the present picture of a camera.

    Args:
        port: Address of the service.
        view: ``front`` or ``rear``.

    Raises:
        ValueError: There is no such view.
        WireDown: There is no picture.
    """
    if view not in PICTURES:
        raise ValueError(f"picture: no camera {view!r}. Use {' or '.join(PICTURES)}")
    client = _client(port)
    try:
        return await _ask(client, view)
    finally:
        client.close()


def take_picture(port: str, view: str = "front") -> Picture:
    """Return a picture as ``picture`` does, for a script without a trio loop."""
    return trio.run(picture, port, view)


class RoverCamera:
    """One camera of the rover, polled on one connection."""

    paced = False

    def __init__(self, client: HttpPort, view: str) -> None:
        self._client = client
        self._view = view
        self._stamp_s: float | None = None  # None before the first picture

    async def read(self) -> contract.Picture:
        """Return a picture that differs from the last one.

        Its time is that of the request, since the rover's clock is not ours; it may have been taken earlier.
        The first picture is dropped. A service that has stopped repeats its last one for ever, and a new
        camera would take that for a new one.
        """
        with trio.move_on_after(PICTURE_S):
            while True:
                asked_ns = time.monotonic_ns()
                answer = await _ask(self._client, self._view)
                before_s, self._stamp_s = self._stamp_s, answer.stamp_s
                if math.isnan(answer.stamp_s) or (before_s is not None and answer.stamp_s != before_s):
                    return contract.Picture(await trio.to_thread.run_sync(_pixels, answer.jpeg), asked_ns)
                await trio.sleep(AGAIN_S)
        raise WireDown(f"picture: the {self._view} camera gives the same one again. Look at the SDK process")

    async def aclose(self) -> None:
        self._client.close()


async def open_camera(settings: contract.CameraSettings) -> RoverCamera:
    """Open a camera. Raise ``WireDown`` if the decoder of pictures is not installed."""
    if why := missing("cameras", "a picture of the rover"):
        raise WireDown(why)
    return RoverCamera(_client(settings.port), settings.view)


def _client(port: str) -> HttpPort:
    return HttpPort(*EarthRover("earthrover", port, {}).config.address(), max_body=PICTURE_SIZE)


async def _ask(client: HttpPort, view: str) -> Picture:
    """Request one picture. Raise ``WireDown``."""
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
