"""Pictures of the rover's cameras, asked of the service by whoever wants them, past the robot's
tree.

They are larger than what actors tell each other, and nothing about them moves the robot.
"""

from __future__ import annotations

import trio

from strands_actors.contract.driver import WireDown
from strands_actors.drivers.common.http_client import HttpClient
from strands_actors.drivers.common.malformed import MalformedFrame

from .driver import EarthRover

__all__ = ["picture", "take_picture"]
from .protocol import NOT_FOUND, OK, PICTURES, Picture, decode_picture

PICTURE_S = 2.0
"""Within which a picture must come."""


async def picture(port: str, view: str = "front") -> Picture:
    """Return what a camera sees now: ``front`` or ``rear``, of the service at ``port``. Raise
    ``ValueError`` for another name, ``WireDown`` when there is no picture."""
    if view not in PICTURES:
        raise ValueError(f"picture: no camera {view!r}. Use {' or '.join(PICTURES)}")
    host, number = EarthRover("earthrover", port, {}).config.address()
    client = HttpClient(f"http://{host}:{number}")
    try:
        answer = await client.get(PICTURES[view], PICTURE_S)
    finally:
        with trio.CancelScope(shield=True):
            await client.aclose()
    if answer.status_code == NOT_FOUND:
        raise WireDown(f"picture: this rover has no {view} camera")
    if answer.status_code != OK:
        raise WireDown(f"picture: status {answer.status_code}. Look at the SDK process")
    try:
        return decode_picture(answer.content, view)
    except MalformedFrame as malformed:
        raise WireDown(f"picture: {malformed}. Look at the SDK process") from None


def take_picture(port: str, view: str = "front") -> Picture:
    """As ``picture``, for a script that runs no trio loop."""
    return trio.run(picture, port, view)
