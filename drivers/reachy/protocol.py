"""Encode and decode the JSON messages of the Reachy Mini daemon (1.13.0). Pure.

Functions here take and return values in axis order and in the driver's units: head pitch, roll and yaw in
degrees, head x, y and z in millimetres, body yaw and the two antennas in degrees. The daemon's messages have
radians and metres, and the right antenna first. The pose of the head is in the frame of the base, so its yaw
includes the yaw of the body.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

API_PORT = 8000
MEDIA_PORT = 8443

STATUS = "/api/daemon/status"
MOTORS = "/api/motors/status"
SET_MODE = "/api/motors/set_mode/"
GOTO = "/api/move/goto"
SET_TARGET = "/api/move/set_target"
RUNNING = "/api/move/running"
STOP = "/api/move/stop"
WAKE_UP = "/api/move/play/wake_up"
GOTO_SLEEP = "/api/move/play/goto_sleep"
PLAY = "/api/move/play/recorded-move-dataset/"
LIST_MOVES = "/api/move/recorded-move-datasets/list/"
DIRECTION_OF_SOUND = "/api/state/doa"
VOLUME = "/api/volume/current"
SET_VOLUME = "/api/volume/set"
PLAY_SOUND = "/api/media/play_sound"
UPLOAD_SOUND = "/api/media/sounds/upload"
TRACKING_ON = "/api/media/tracking/enable"
TRACKING_OFF = "/api/media/tracking/disable"
TRACKED_FACE = "/api/media/tracking/face"
CAMERA = "/api/camera/specs"

SDK = "/ws/sdk"
UPDATES = "/api/move/ws/updates"

OK, NOT_FOUND = 200, 404
MODES = ("disabled", "enabled", "gravity_compensation")
"""Modes of the motors. The index is the number under which the mode is observed."""

DATASET = "pollen-robotics/reachy-mini-emotions-library"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
"""Pattern of the name of a recorded move, and of each part of a dataset's name."""

STOP_MOVE = '{"type":"stop_move"}'
"""Ends the move that is being played, from any client. It has no answer."""
TRACKING_STOP = '{"type":"set_head_tracking","enabled":false}'
WOBBLING_STOP = '{"type":"set_wobbling","enabled":false}'
MOTORS_OFF = '{"type":"set_motor_mode","mode":"disabled"}'

COMPLETED = "move_completed"
ENDS = (COMPLETED, "move_failed", "move_cancelled")

PITCH, ROLL, YAW, X, Y, Z, BODY, LEFT, RIGHT = range(9)
"""Indices of the axes in a row."""

_JSON = msgspec.json.Decoder()
_UUID = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")


class Joints(msgspec.Struct, frozen=True):
    """Measured joints, in degrees."""

    body: float
    left: float
    right: float


class Head(msgspec.Struct, frozen=True):
    """Measured pose of the head."""

    xyz_m: tuple[float, float, float]
    rpy_rad: tuple[float, float, float]


class Imu(msgspec.Struct, frozen=True):
    """Readings of the inertial sensor. A Reachy Mini Wireless has one, a Lite does not."""

    accelerometer_m_s2: tuple[float, ...]
    gyroscope_rad_s: tuple[float, ...]
    quaternion_wxyz: tuple[float, ...]
    temperature_c: float


class Status(msgspec.Struct, frozen=True):
    """State of the daemon. ``battery_pct`` is NaN if the daemon does not send it. Version 1.13.0 does not."""

    state: str
    wireless: bool
    simulated: bool
    version: str
    name: str
    error: str
    battery_pct: float


class Update(msgspec.Struct, frozen=True):
    """An event in the life of a move, such as its end."""

    event_type: str
    uuid: str
    details: str


def encode_target(values: Sequence[float]) -> bytes:
    """Encode a target that takes effect at once, as the body of a request."""
    return msgspec.json.encode(
        {
            "target_head_pose": _pose(values),
            "target_antennas": [math.radians(values[RIGHT]), math.radians(values[LEFT])],
            "target_body_yaw": math.radians(values[BODY]),
        }
    )


def encode_goto(values: Sequence[float], duration_s: float) -> bytes:
    """Encode a move of this duration, as the body of a request."""
    return msgspec.json.encode(
        {
            "head_pose": _pose(values),
            "antennas": [math.radians(values[RIGHT]), math.radians(values[LEFT])],
            "body_yaw": math.radians(values[BODY]),
            "duration": duration_s,
            "interpolation": "minjerk",
        }
    )


def encode_uuid(uuid: str) -> bytes:
    """Encode the id of a move, as the body of a request."""
    return msgspec.json.encode({"uuid": uuid})


def row_of(head: Head, joints: Joints) -> tuple[float, ...]:
    """Return the measured values in axis order."""
    roll, pitch, yaw = (math.degrees(angle) for angle in head.rpy_rad)
    x, y, z = (1e3 * length for length in head.xyz_m)
    return (pitch, roll, yaw, x, y, z, joints.body, joints.left, joints.right)


def decode_sdk(message: str | bytes) -> Joints | Head | Imu | Status | None:
    """Decode a message from ``/ws/sdk``. Return None for a type that this driver does not use. Raise
    ``MalformedFrame``."""
    fields = _object(message)
    match fields.get("type"):
        case "joint_positions":
            head, (right, left) = (
                _row(fields, "head_joint_positions", 7),
                _row(fields, "antennas_joint_positions", 2),
            )
            return Joints(math.degrees(head[0]), math.degrees(left), math.degrees(right))
        case "head_pose":
            return _head(fields.get("head_pose"))
        case "imu_data":
            return Imu(
                _row(fields, "accelerometer", 3),
                _row(fields, "gyroscope", 3),
                _row(fields, "quaternion", 4),
                _number(fields, "temperature"),
            )
        case "daemon_status":
            return _status(fields)
    return None


def decode_status(body: bytes) -> Status:
    """Decode the answer to ``GET /api/daemon/status``. Raise ``MalformedFrame``."""
    return _status(_object(body))


def decode_mode(body: bytes) -> int:
    """Return the motors' mode as its index in ``MODES``. Raise ``MalformedFrame``."""
    mode = _text(_object(body), "mode")
    if mode not in MODES:
        raise MalformedFrame(f"mode {mode[:40]!r}")
    return MODES.index(mode)


def decode_running(body: bytes) -> tuple[str, ...]:
    """Decode the list of running moves. Return their ids. Raise ``MalformedFrame``."""
    moves = _decode(body)
    if not isinstance(moves, list):
        raise MalformedFrame("the running moves are no list")
    return tuple(_uuid(move) for move in moves)


def decode_move(body: bytes) -> str:
    """Return the id of a move that has begun. Raise ``MalformedFrame``."""
    return _uuid(_object(body))


def decode_update(message: str | bytes) -> Update:
    """Decode a message from ``/api/move/ws/updates``. Raise ``MalformedFrame``."""
    fields = _object(message)
    return Update(_text(fields, "type"), _uuid(fields), str(fields.get("details") or "")[:200])


def decode_target_answer(body: bytes) -> bool:
    """Return True if the daemon accepted a target, and False if it ignored it because a move runs. Raise
    ``MalformedFrame``."""
    status = _text(_object(body), "status")
    if status not in ("ok", "ignored"):
        raise MalformedFrame(f"status {status[:40]!r}")
    return status == "ok"


def decode_direction(body: bytes) -> tuple[float, bool] | None:
    """Return the direction of sound in degrees to the left of straight ahead, and whether it is speech.

    None without a microphone. Raise ``MalformedFrame``.
    """
    if _decode(body) is None:
        return None
    fields = _object(body)
    return 90.0 - math.degrees(_number(fields, "angle")), fields.get("speech_detected") is True


def decode_object(body: bytes) -> dict[str, Any]:
    """Decode a JSON object of any content. Raise ``MalformedFrame``."""
    return _object(body)


def decode_names(body: bytes) -> list[str]:
    """Decode a list of names. Raise ``MalformedFrame``."""
    names = _decode(body)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise MalformedFrame("no list of names")
    return names


def _pose(values: Sequence[float]) -> dict[str, float]:
    return {
        "x": values[X] / 1e3,
        "y": values[Y] / 1e3,
        "z": values[Z] / 1e3,
        "roll": math.radians(values[ROLL]),
        "pitch": math.radians(values[PITCH]),
        "yaw": math.radians(values[YAW]),
    }


def _head(pose: object) -> Head:
    """Convert a 4 by 4 matrix to a position, and roll, pitch and yaw about the fixed x, y and z."""
    if not isinstance(pose, list) or len(pose) != 4:
        raise MalformedFrame("head_pose is no 4 by 4 matrix")
    m = [_row({"row": row}, "row", 4) for row in pose]
    rpy = math.atan2(m[2][1], m[2][2]), -math.asin(max(-1.0, min(1.0, m[2][0]))), math.atan2(m[1][0], m[0][0])
    return Head((m[0][3], m[1][3], m[2][3]), rpy)


def _status(fields: dict[str, Any]) -> Status:
    backend = fields.get("backend_status")
    error = fields.get("error") or (backend.get("error") if isinstance(backend, dict) else None)
    # The name of this field is [assumed], because no daemon that we have tried sends it.
    battery = fields.get("battery_pct")
    return Status(
        state=_text(fields, "state"),
        wireless=fields.get("wireless_version") is True,
        simulated=fields.get("simulation_enabled") is True or fields.get("mockup_sim_enabled") is True,
        version=str(fields.get("version") or "unknown")[:40],
        name=str(fields.get("robot_name") or "")[:64],
        error=str(error or "")[:200],
        battery_pct=math.nan if battery is None else _number(fields, "battery_pct"),
    )


def _decode(data: str | bytes) -> Any:
    try:
        return _JSON.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedFrame(f"no JSON: {error}") from None


def _object(data: str | bytes) -> dict[str, Any]:
    fields = _decode(data)
    if not isinstance(fields, dict):
        raise MalformedFrame("no JSON object")
    return fields


def _text(fields: dict[str, Any], name: str) -> str:
    value = fields.get(name)
    if not isinstance(value, str):
        raise MalformedFrame(f"no {name}")
    return value


def _number(fields: dict[str, Any], name: str) -> float:
    return _row({name: [fields.get(name)]}, name, 1)[0]


def _row(fields: dict[str, Any], name: str, length: int) -> tuple[float, ...]:
    try:
        row = msgspec.convert(fields.get(name), list[float])
    except msgspec.ValidationError:
        raise MalformedFrame(f"{name} has no numbers") from None
    if len(row) != length or not all(math.isfinite(value) for value in row):
        raise MalformedFrame(f"{name} has not {length} finite numbers")
    return tuple(row)


def _uuid(move: object) -> str:
    uuid = move.get("uuid") if isinstance(move, dict) else None
    if not isinstance(uuid, str) or not _UUID.fullmatch(uuid):
        raise MalformedFrame("no uuid of a move")
    return uuid
