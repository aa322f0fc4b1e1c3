"""The report of a camera on its own state, stored next to its pictures. ``get_status()`` shows it, and it
explains a missing picture."""

from __future__ import annotations

import msgspec

WHY_LETTERS = 600
"""Most characters of a reason. The rest is cut off."""


class Told(msgspec.Struct, frozen=True):
    """The state of a camera.

    Attributes:
        state: ``starting``; ``streaming``; ``unavailable``: it cannot be opened, or was unplugged;
            ``refused``: it does not give the requested pictures; ``down``: its process has ended.
        why: The reason if there are no pictures.
        opened: How often the present process has opened the source.
        fps: Measured pictures per second.
        width: In pixels.
        height: In pixels.
        compressed: Why there is no JPEG; empty without a problem.
    """

    state: str = "starting"
    why: str = ""
    opened: int = 0
    fps: float = 0.0
    width: int = 0
    height: int = 0
    compressed: str = ""


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Told)


def encode(told: Told) -> bytes:
    short = told if len(told.why) <= WHY_LETTERS else msgspec.structs.replace(told, why=told.why[:WHY_LETTERS])
    return _encoder.encode(short)


def decode(data: bytes) -> Told:
    """Return the decoded report; the default if it cannot be read."""
    try:
        return _decoder.decode(data)
    except msgspec.MsgspecError:
        return Told()
