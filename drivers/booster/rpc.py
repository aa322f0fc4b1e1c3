"""Encode and decode a T1's service: requests, responses and their arguments. Pure: no I/O.

A message is three texts: a unique id that a request shares with its response, a header in JSON and a
body in JSON.
"""

from __future__ import annotations

import enum
import json
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from strands_actors.contract.axis import finite
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

REQUEST_TYPE = "booster_msgs::msg::dds_::RpcReqMsg_"
RESPONSE_TYPE = "booster_msgs::msg::dds_::RpcRespMsg_"


class Api(enum.IntEnum):
    CHANGE_MODE = 2000
    MOVE = 2001
    ROTATE_HEAD = 2004
    GET_UP = 2008
    GET_FRAME_TRANSFORM = 2011
    GET_MODE = 2017
    GET_STATUS = 2018
    GET_ROBOT_INFO = 2022
    UPPER_BODY = 2030
    RESET_ODOMETRY = 2031
    GET_SENSORS = 2044
    GET_HANDS = 2045
    GET_ROBOT_MODEL = 2046


class Mode(enum.IntEnum):
    UNKNOWN = -1
    DAMPING = 0
    PREPARE = 1
    WALKING = 2
    CUSTOM = 3
    SOCCER = 4


WALKS = (Mode.WALKING, Mode.SOCCER)
STANDS = (Mode.PREPARE, *WALKS)
"""Modes in which the robot's own controller keeps it up."""
NEVER_WALKS = (Mode.DAMPING, Mode.PREPARE, Mode.CUSTOM)
"""Modes in which a Move has no effect."""

CALL, FIRE_AND_FORGET = 0, 2
"""``call_mode`` of a request: with a response, or without one."""

OK, BAD_REQUEST, CONFLICT, TOO_FREQUENT, REFUSED, TRANSITION_FAILED = 0, 400, 409, 429, 501, 502
STATUS_WORDS = {
    -1: "invalid",
    100: "the request timed out in the client",
    400: "bad request",
    409: "conflict",
    429: "too frequent",
    500: "internal error",
    501: "refused",
    502: "the change of state failed",
}

MAX_TEXT = 65536
_LENGTH = struct.Struct("<I")


class Request(NamedTuple):
    id: str
    api: int
    body: str = ""
    wants_answer: bool = True


class Response(NamedTuple):
    id: str
    status: int
    body: str = ""

    @property
    def error(self) -> str:
        """Return the meaning of the status in a response; empty for success."""
        return "" if self.status == OK else f"{STATUS_WORDS.get(self.status, 'an error')} ({self.status})"


def request_topic(robot_name: str) -> str:
    return f"rt/LocoApiTopic/{robot_name}Req" if robot_name else "rt/LocoApiTopicReq"


def response_topic(robot_name: str) -> str:
    return f"rt/LocoApiTopic/{robot_name}Resp" if robot_name else "rt/LocoApiTopicResp"


def encode_request(request: Request) -> bytes:
    """Encode a request. Its JSON header has the fields that the vendor's SDK 1.6.3 sends, and
    ``expect_response``, which appears only in the vendor's published header files."""
    mode = CALL if request.wants_answer else FIRE_AND_FORGET
    header = {
        "api_id": request.api,
        "call_mode": mode,
        "expect_response": request.wants_answer,
        "req_id": request.id,
    }
    return _texts(request.id, json.dumps(header), request.body)


def decode_request(payload: bytes | memoryview) -> Request:
    """Decode a request. Raise ``MalformedFrame``."""
    number, text, body = _read_texts(payload)
    header = parsed(text)
    api = header.get("api_id")
    if isinstance(api, bool) or not isinstance(api, int):
        raise MalformedFrame(f"an api_id of {api!r}")
    wants_answer = header.get("expect_response", header.get("call_mode", CALL) != FIRE_AND_FORGET)
    return Request(number, api, body, bool(wants_answer))


def encode_response(response: Response) -> bytes:
    return _texts(response.id, json.dumps({"status": response.status}), response.body)


def decode_response(payload: bytes | memoryview) -> Response:
    """Decode a response. Raise ``MalformedFrame``."""
    number, text, body = _read_texts(payload)
    status = parsed(text).get("status")
    if isinstance(status, bool) or not isinstance(status, int):
        raise MalformedFrame(f"a status of {status!r}")
    return Response(number, status, body)


def mode_of(body: str) -> Mode:
    """Decode the mode in an answer to GetMode. An unlisted number gives ``UNKNOWN``. Raise
    ``MalformedFrame``."""
    number = parsed(body).get("mode")
    if isinstance(number, bool) or not isinstance(number, int):
        raise MalformedFrame(f"a mode of {number!r}")
    return Mode(number) if number in Mode.__members__.values() else Mode.UNKNOWN


def number_in(body: Mapping[str, Any], name: str) -> float:
    """Return the number in a field of a JSON body. Raise ``MalformedFrame`` if it is not a finite
    number."""
    value = finite(body.get(name))
    if value is None:
        raise MalformedFrame(f"{name} is {body.get(name)!r}")
    return value


def move(vx_m_s: float, vy_m_s: float, vyaw_rad_s: float) -> str:
    return json.dumps({"vx": vx_m_s, "vy": vy_m_s, "vyaw": vyaw_rad_s})


ZERO = move(0.0, 0.0, 0.0)
"""The body of a Move that stops the base."""


def rotate_head(pitch_rad: float, yaw_rad: float) -> str:
    return json.dumps({"pitch": pitch_rad, "yaw": yaw_rad})


def change_mode(mode: Mode) -> str:
    return json.dumps({"mode": int(mode)})


def upper_body(host_has_arms: bool) -> str:
    return json.dumps({"start": host_has_arms})


def parsed(text: str) -> dict[str, Any]:
    """Decode a header or a body, which must be a JSON object. Raise ``MalformedFrame``."""
    try:
        value = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        raise MalformedFrame(f"no JSON: {error}") from None
    if not isinstance(value, dict):
        raise MalformedFrame("no JSON object")
    return value


def _texts(*texts: str) -> bytes:
    encoded = []
    for text in texts:
        data = text.encode() + b"\0"
        encoded.append(_LENGTH.pack(len(data)) + data + bytes(-len(data) % 4))
    return b"".join(encoded)


def _read_texts(payload: bytes | memoryview) -> tuple[str, str, str]:
    texts: list[str] = []
    offset = 0
    for _ in range(3):
        if len(payload) < offset + _LENGTH.size:
            raise MalformedFrame("a message of fewer than three texts")
        (length,) = _LENGTH.unpack_from(payload, offset)
        offset += _LENGTH.size
        data = bytes(payload[offset : offset + length])
        if length > MAX_TEXT or len(data) != length or not data or data[-1]:
            raise MalformedFrame("a text that does not end")
        try:
            texts.append(data[:-1].decode())
        except UnicodeDecodeError as error:
            raise MalformedFrame(f"a text that is not UTF-8: {error}") from None
        offset += length + -length % 4
    return texts[0], texts[1], texts[2]
