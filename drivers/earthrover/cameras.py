"""Read pictures of the rover's cameras from the HTTP service of the vendor's SDK process.

The process of a camera (``cameras={"front": {}}``) uses this module, and any other program may use it, too.
Pictures do not pass through the messages of the robot's processes, because they are too large for these. A request
for a picture never moves the robot.
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
"""Longest time for one request, and for a picture that differs from the last one."""
PICTURE_SIZE = 4 << 20
"""Largest answer in bytes: a JPEG in base64."""
AGAIN_S = 0.02
"""Pause before the next request if the picture has not changed."""


async def picture(port: str, view: str = "front") -> Picture:
    """Return the present picture of a camera.

    Args:
        port: Address of the SDK process, ``host`` or ``host:port``.
        view: ``front`` or ``rear``.

    Raises:
        ValueError: ``view`` is neither of these.
        WireDown: The SDK process gave no picture.
    """
    if view not in PICTURES:
        raise ValueError(f"picture: there is no camera {view!r}. Use {' or '.join(PICTURES)}")
    client = _client(port)
    try:
        return await _ask(client, view)
    finally:
        client.close()


def take_picture(port: str, view: str = "front") -> Picture:
    """Return a picture as ``picture`` does, for a script without a trio event loop."""
    return trio.run(picture, port, view)


class RoverCamera:
    """One camera of the rover. It requests pictures again and again over one connection."""

    paced = False

    def __init__(self, client: HttpPort, view: str) -> None:
        self._client = client
        self._view = view
        self._stamp_s: float | None = None  # the rover's time of the last picture; None before the first one

    async def read(self) -> contract.Picture:
        """Return a picture that differs from the last one.

        The time of the picture is the time of our request, since the rover's clock cannot be compared with ours.
        The picture itself may be older. The first picture is dropped, since a service without new pictures repeats
        its last one for ever. Only a second, different picture shows that new ones come.
        """
        with trio.move_on_after(PICTURE_S):
            while True:
                requested_ns = time.monotonic_ns()
                answer = await _ask(self._client, self._view)
                before_s, self._stamp_s = self._stamp_s, answer.stamp_s
                if math.isnan(answer.stamp_s) or (before_s is not None and answer.stamp_s != before_s):
                    return contract.Picture(await trio.to_thread.run_sync(_pixels, answer.jpeg), requested_ns)
                await trio.sleep(AGAIN_S)
        raise WireDown(
            f"picture: the {self._view} camera repeats its last picture. Check the rover and the SDK process"
        )

    async def aclose(self) -> None:
        self._client.close()


async def open_camera(settings: contract.CameraSettings) -> RoverCamera:
    """Open a camera. Raise ``WireDown`` if OpenCV, which decodes the pictures, is not installed."""
    if problem := missing("cameras", "a picture of the rover"):
        raise WireDown(problem)
    return RoverCamera(_client(settings.port), settings.view)


def _client(port: str) -> HttpPort:
    return HttpPort(*EarthRover("earthrover", port, {}).config.address(), max_body=PICTURE_SIZE)


async def _ask(client: HttpPort, view: str) -> Picture:
    """Request one picture. Raise ``WireDown`` if no valid picture comes."""
    answer = await client.ask("GET", PICTURES[view], within_s=PICTURE_S)
    if answer.status == NOT_FOUND:
        raise WireDown(f"picture: this rover has no {view} camera")
    if answer.status != OK:
        raise WireDown(f"picture: the SDK process answered with HTTP status {answer.status}. Check the SDK process")
    try:
        return decode_picture(answer.body, view)
    except MalformedFrame as malformed:
        raise WireDown(
            f"picture: the answer of the SDK process is invalid ({malformed}). Check its version"
        ) from None


def _pixels(jpeg: bytes) -> NDArray[numpy.uint8]:
    import cv2
    import numpy

    image = cv2.imdecode(numpy.frombuffer(jpeg, numpy.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise WireDown("picture: the SDK process sent data that is no JPEG. Check its version")
    rgb: NDArray[numpy.uint8] = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return rgb
