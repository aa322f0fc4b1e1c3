"""The report of a camera on its state, stored in the file of its pictures. ``get_status()`` shows the
report, and a reader uses it to explain why there is no new picture."""

from __future__ import annotations

import msgspec

REASON_LETTERS = 600
"""Most characters of a reason. The rest is cut off."""


class CameraReport(msgspec.Struct, frozen=True):
    """The state of a camera.

    Attributes:
        state: ``starting``; ``streaming``; ``unavailable``: the camera cannot be opened, or was unplugged;
            ``refused``: the camera does not give the requested pictures; ``down``: its process has ended.
        reason: The reason if there are no pictures.
        opened: How often the camera's present process has opened the camera.
        fps: Measured pictures per second.
        width: In pixels.
        height: In pixels.
        compressed: Why pictures are not available as JPEG; empty without a problem.
    """

    state: str = "starting"
    reason: str = msgspec.field(default="", name="why")
    opened: int = 0
    fps: float = 0.0
    width: int = 0
    height: int = 0
    compressed: str = ""


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(CameraReport)


def encode(report: CameraReport) -> bytes:
    short = (
        report
        if len(report.reason) <= REASON_LETTERS
        else msgspec.structs.replace(report, reason=report.reason[:REASON_LETTERS])
    )
    return _encoder.encode(short)


def decode(data: bytes) -> CameraReport:
    """Return the decoded report. If it cannot be decoded, return a report with the default values."""
    try:
        return _decoder.decode(data)
    except msgspec.MsgspecError:
        return CameraReport()
