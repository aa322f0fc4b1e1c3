"""Encode and decode the JSON bodies of the EarthRover's SDK process. Pure: no I/O.

A stop command has whole numbers (``0``), a setpoint has fractions (``0.0``). The service treats both alike. The
log of sent frames uses the difference to mark stops.
"""

from __future__ import annotations

import base64
import binascii
import math
from typing import Any

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

PORT = 8000
CONTROL = "/control"
DATA = "/data"
SPEAK = "/speak"
SPEAK_S = 5.0
"""Longest time to speak a text."""
PICTURES = {"front": "/v2/front", "rear": "/v2/rear"}

OK = 200
BAD_REQUEST = 400
NOT_FOUND = 404

LIT = 0.5
"""A lamp is lit from this value on. The service itself has 0 and 1 only."""

_VECTORS = ("accels", "gyros", "mags", "rpms")
_JSON = msgspec.json.Decoder()


class Data(msgspec.Struct, frozen=True):
    """One decoded answer to ``GET /data``. A value that the rover does not report is NaN."""

    stamp_s: float  # time of the report on the rover's clock, in seconds
    speed: float  # speed of the rover; unit not documented
    battery_pct: float
    signal_level: float
    heading_deg: float
    # NaN without a GPS fix.
    latitude_deg: float
    longitude_deg: float
    lamp: float
    vibration: float
    # Newest row of each sensor in ``_VECTORS``, without its time; units not documented.
    vectors: dict[str, tuple[float, ...]]


class Picture(msgspec.Struct, frozen=True):
    """A picture of one camera."""

    jpeg: bytes
    stamp_s: float  # time of the picture on the rover's clock, in seconds; NaN if the rover does not report it


def decode_picture(body: bytes, view: str) -> Picture:
    """Decode an answer to ``GET /v2/front`` or ``GET /v2/rear``. Raise ``MalformedFrame`` if it contains no valid
    picture."""
    fields = _decode(body)
    frame = fields.get(f"{view}_frame")
    if not isinstance(frame, str) or not frame:
        raise MalformedFrame(f"no {view}_frame")
    try:
        return Picture(base64.b64decode(frame, validate=True), _number(fields, "timestamp"))
    except (binascii.Error, ValueError):
        raise MalformedFrame(f"{view}_frame is no base64") from None


def encode_setpoint(linear: float, angular: float, lamp: float) -> bytes:
    """Return the body of a command. ``linear`` and ``angular`` are fractions of full speed."""
    command = {"linear": float(linear), "angular": float(angular), "lamp": int(lamp >= LIT)}
    return msgspec.json.encode({"command": command})


def encode_stop(lamp: float) -> bytes:
    """Return the body of a stop command. The lamp keeps the state ``lamp``."""
    return msgspec.json.encode({"command": {"linear": 0, "angular": 0, "lamp": int(lamp >= LIT)}})


def decode_command(body: bytes) -> dict[str, Any] | None:
    """Return the command in the body of a ``POST /control``; None if it has no command. Raise ``MalformedFrame``
    for an invalid body."""
    command = _decode(body).get("command")
    return command if isinstance(command, dict) and command else None


def decode_text(body: bytes) -> str:
    """Return the text in the body of a ``POST /speak``; empty if it has none. Raise ``MalformedFrame`` for an
    invalid body."""
    text = _decode(body).get("text")
    return text if isinstance(text, str) else ""


def is_stop(command: dict[str, Any]) -> bool:
    """Return True if a command is a stop command (``encode_stop``), and False for a setpoint."""
    return all(type(command.get(name)) is int and command[name] == 0 for name in ("linear", "angular"))


def decode_data(body: bytes) -> Data:
    """Decode an answer to ``GET /data``. Raise ``MalformedFrame`` if it has no time or no speed."""
    fields = _decode(body)
    stamp, speed = _number(fields, "timestamp"), _number(fields, "speed")
    if math.isnan(stamp) or math.isnan(speed):
        raise MalformedFrame("data without a timestamp or a speed")
    latitude, longitude = _number(fields, "latitude"), _number(fields, "longitude")
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # Without a fix the rover reports 1000.
        latitude = longitude = math.nan
    return Data(
        stamp,
        speed,
        _number(fields, "battery"),
        _number(fields, "signal_level"),
        _number(fields, "orientation"),
        latitude,
        longitude,
        _number(fields, "lamp"),
        _number(fields, "vibration"),
        {name: row for name in _VECTORS if (row := _newest(fields.get(name)))},
    )


def _decode(body: bytes) -> dict[str, Any]:
    try:
        value = _JSON.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedFrame(f"no JSON ({error})") from None
    if not isinstance(value, dict):
        raise MalformedFrame("JSON, but no object")
    return value


def _number(fields: dict[str, Any], name: str) -> float:
    number = finite(fields.get(name))
    return math.nan if number is None else number


def _newest(rows: object) -> tuple[float, ...]:
    """Return the newest row of a sensor's rows, without the row's last number, which is its time. Empty if there
    is no row."""
    if not isinstance(rows, list) or not rows or not isinstance(rows[-1], list) or len(rows[-1]) < 2:
        return ()
    numbers = [finite(value) for value in rows[-1][:-1]]
    return tuple(math.nan if number is None else number for number in numbers)
