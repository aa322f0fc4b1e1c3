"""What is said to and heard of the EarthRover's SDK process, as JSON in the bodies of HTTP
messages. Pure.

A stop is written in whole numbers (``0``), a setpoint in fractions (``0.0``): to the service they
are the same, and the log of the wire tells a stop from a setpoint of zero.
"""

from __future__ import annotations

import base64
import binascii
import math
from typing import Any

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.drivers.common.malformed import MalformedFrame

PORT = 8000
CONTROL = "/control"
DATA = "/data"
SPEAK = "/speak"
SPEAK_S = 5.0
"""Longest time that saying a text may take."""
PICTURES = {"front": "/v2/front", "rear": "/v2/rear"}

OK = 200
BAD_REQUEST = 400
NOT_FOUND = 404

LIT = 0.5
"""From this on a lamp is lit: the service knows 0 and 1."""

_VECTORS = ("accels", "gyros", "mags", "rpms")
_JSON = msgspec.json.Decoder()


class Data(msgspec.Struct, frozen=True):
    """One answer to ``GET /data``. What the rover did not tell is NaN."""

    stamp_s: float  # the rover's clock
    speed: float  # unit not documented
    battery_pct: float
    signal_level: float
    heading_deg: float
    latitude_deg: float  # NaN without a fix
    longitude_deg: float
    lamp: float
    vibration: float
    vectors: dict[str, tuple[float, ...]]  # the newest row of each, without its time; units not documented


class Picture(msgspec.Struct, frozen=True):
    """What a camera saw."""

    jpeg: bytes
    stamp_s: float  # the rover's clock; NaN: not told


def decode_picture(body: bytes, view: str) -> Picture:
    """Return an answer to ``GET /v2/VIEW``. Raise ``MalformedFrame``."""
    told = _decode(body)
    frame = told.get(f"{view}_frame")
    if not isinstance(frame, str) or not frame:
        raise MalformedFrame(f"no {view}_frame")
    try:
        return Picture(base64.b64decode(frame, validate=True), _number(told, "timestamp"))
    except (binascii.Error, ValueError):
        raise MalformedFrame(f"{view}_frame is no base64") from None


def encode_setpoint(linear: float, angular: float, lamp: float) -> bytes:
    """Return the body of a command: fractions of full speed, and whether the lamp is lit."""
    command = {"linear": float(linear), "angular": float(angular), "lamp": int(lamp >= LIT)}
    return msgspec.json.encode({"command": command})


def encode_stop(lamp: float) -> bytes:
    """Return the body of a stop."""
    return msgspec.json.encode({"command": {"linear": 0, "angular": 0, "lamp": int(lamp >= LIT)}})


def decode_command(body: bytes) -> dict[str, Any] | None:
    """Return the command of a body of ``POST /control``; None where there is none. Raise
    ``MalformedFrame``."""
    command = _decode(body).get("command")
    return command if isinstance(command, dict) and command else None


def is_stop(command: dict[str, Any]) -> bool:
    """Whether a command is a stop, not a setpoint."""
    return all(type(command.get(name)) is int and command[name] == 0 for name in ("linear", "angular"))


def decode_data(body: bytes) -> Data:
    """Return an answer to ``GET /data``. Raise ``MalformedFrame`` for one without a time or a
    speed."""
    told = _decode(body)
    stamp, speed = _number(told, "timestamp"), _number(told, "speed")
    if math.isnan(stamp) or math.isnan(speed):
        raise MalformedFrame("data without a timestamp or a speed")
    latitude, longitude = _number(told, "latitude"), _number(told, "longitude")
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # 1000 is what it says without a fix
        latitude = longitude = math.nan
    return Data(
        stamp,
        speed,
        _number(told, "battery"),
        _number(told, "signal_level"),
        _number(told, "orientation"),
        latitude,
        longitude,
        _number(told, "lamp"),
        _number(told, "vibration"),
        {name: row for name in _VECTORS if (row := _newest(told.get(name)))},
    )


def _decode(body: bytes) -> dict[str, Any]:
    try:
        told = _JSON.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedFrame(f"no JSON ({error})") from None
    if not isinstance(told, dict):
        raise MalformedFrame("JSON, but no object")
    return told


def _number(told: dict[str, Any], name: str) -> float:
    number = finite(told.get(name))
    return math.nan if number is None else number


def _newest(rows: object) -> tuple[float, ...]:
    """Return the last of several rows of numbers, less its last, which is a time; empty where there
    is none."""
    if not isinstance(rows, list) or not rows or not isinstance(rows[-1], list) or len(rows[-1]) < 2:
        return ()
    numbers = [finite(value) for value in rows[-1][:-1]]
    return tuple(math.nan if number is None else number for number in numbers)
