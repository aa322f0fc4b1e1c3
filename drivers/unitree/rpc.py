"""Encode and decode requests to Unitree's services, and their responses. No I/O, no clock.

A request is sent on the topic ``rt/api/<service>/request``, and its response on ``rt/api/<service>/response``. A
response has the id of its request.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Any, NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

REQUEST_TYPE = "unitree_api::msg::dds_::Request_"
RESPONSE_TYPE = "unitree_api::msg::dds_::Response_"

MOTION_SWITCHER = "motion_switcher"
SERVER_VERSION = 1
CHECK_MODE, SELECT_MODE, RELEASE_MODE = 1001, 1002, 1003

ATTEMPTS = 5
RELEASE_S = 3.0
"""Longest time of the robot for one attempt to release its mode."""

GET_FSM_ID, SET_FSM_ID, SET_BALANCE_MODE, SET_VELOCITY = 7001, 7101, 7102, 7105
"""Requests of the service ``sport`` on a G1."""
LOCO_GET_FSM_ID, LOCO_SET_FSM_ID, LOCO_SET_BALANCE_MODE, LOCO_SET_VELOCITY = 8001, 8101, 8102, 8105
LOCO_ENABLE_ODOM, LOCO_GET_ODOM = 8201, 8203
"""Requests of the service ``loco`` on an H1."""
DAMP, BALANCE_STAND, STOP_MOVE, STAND_UP, STAND_DOWN, RECOVERY_STAND, MOVE = (
    1001,
    1002,
    1003,
    1004,
    1005,
    1006,
    1008,
)
"""Requests of the service ``sport`` on a Go2 or B2."""
SIT, RISE_SIT = 1009, 1010
"""Requests of a Go2 only."""

OK, TIMEOUT, NOT_IMPLEMENTED, BAD_DATA, NOT_REGISTERED = 0, 3104, 3203, 3106, 3103
NO_SUCH_FSM = 7302

SELECTED_TOO_SOON = 7002
"""Code of SelectMode for some ten seconds after ReleaseMode."""

ERRORS = {
    7002: "its mode was released a moment ago",
    3001: "an unknown error",
    3102: "the request could not be sent",
    3103: "the service does not know this request",
    3104: "the service does not answer",
    3105: "another request was answered",
    3106: "bad data",
    3107: "the lease is denied",
    3203: "not implemented",
    4201: "the action took too long",
    4202: "the sport service has not started",
    4205: "the sport service has not started",
    7301: "the locomotion state is missing",
    7302: "no such state of the FSM",
    7303: "no such task",
    7400: "the arm's topic is taken",
    7401: "the arm is held",
    7402: "no such action",
    7404: "the FSM is not in 500, 501 or 801",
}

FSM_WORDS = {
    0: "zero torque",
    1: "damp",
    2: "squat",
    3: "sit",
    4: "stand with locked joints",
    500: "start",
    501: "walk",
    702: "stand up",
    706: "between squat and stand",
    801: "walk",
}
"""FSM states of a G1."""

_REQUEST = struct.Struct("<qqqi?3xI")
_RESPONSE = struct.Struct("<qqiI")
MAX_TEXT = 65536


def request_topic(service: str) -> str:
    return f"rt/api/{service}/request"


def response_topic(service: str) -> str:
    return f"rt/api/{service}/response"


class Request(NamedTuple):
    id: int
    api: int
    parameter: str = ""
    no_reply: bool = False


class Response(NamedTuple):
    id: int
    api: int
    code: int
    data: str = ""

    @property
    def error(self) -> str:
        """The meaning of the response's error code. Empty for success."""
        return "" if self.code == OK else f"{ERRORS.get(self.code, 'an error')} ({self.code})"


def encode_request(request: Request) -> bytes:
    text = _text(request.parameter)
    head = _REQUEST.pack(request.id, request.api, 0, 0, request.no_reply, len(text))
    return _with_empty_binary(head + text)


def decode_request(body: bytes) -> Request:
    """Raise ``MalformedFrame``."""
    if len(body) < _REQUEST.size:
        raise MalformedFrame(f"a request has {_REQUEST.size} bytes at least, not {len(body)}")
    number, api, _, _, no_reply, length = _REQUEST.unpack_from(body)
    return Request(number, api, _read_text(body, _REQUEST.size, length), no_reply)


def encode_response(response: Response) -> bytes:
    text = _text(response.data)
    return _with_empty_binary(_RESPONSE.pack(response.id, response.api, response.code, len(text)) + text)


def decode_response(body: bytes) -> Response:
    """Raise ``MalformedFrame``."""
    if len(body) < _RESPONSE.size:
        raise MalformedFrame(f"a response has {_RESPONSE.size} bytes at least, not {len(body)}")
    number, api, code, length = _RESPONSE.unpack_from(body)
    return Response(number, api, code, _read_text(body, _RESPONSE.size, length))


def _text(text: str) -> bytes:
    return text.encode() + b"\0"


def _with_empty_binary(body: bytes) -> bytes:
    return body + bytes(-len(body) % 4 + 4)


def _read_text(body: bytes, offset: int, length: int) -> str:
    data = body[offset : offset + length]
    if length > MAX_TEXT or len(data) != length or (length and data[-1]):
        raise MalformedFrame("a text that does not end")
    try:
        return data[:-1].decode()
    except UnicodeDecodeError as error:
        raise MalformedFrame(f"a text that is none: {error}") from None


def parsed(text: str) -> dict[str, Any]:
    """Decode the JSON object in a request's parameter or in a response's data.

    Raise ``MalformedFrame`` if the text is not a JSON object.
    """
    try:
        value = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        raise MalformedFrame(f"no JSON: {error}") from None
    if not isinstance(value, dict):
        raise MalformedFrame("no JSON object")
    return value


def fsm_id(response: Response) -> int:
    """Return the FSM id in a response to GetFsmId. Raise ``MalformedFrame`` if it has no number."""
    value = parsed(response.data).get("data")
    if isinstance(value, bool) or not isinstance(value, int):
        raise MalformedFrame(f"an FSM id of {value!r}")
    return value


def odometry(response: Response) -> tuple[float, float, float]:
    """Return the pose in a response to GetOdom: x and y in m, and the heading in rad.

    Raise ``MalformedFrame`` if it has no pose.
    """
    value = parsed(response.data)
    try:
        x, y, heading = (float(value[key]) for key in ("x", "y", "z"))
    except (KeyError, TypeError, ValueError) as error:
        raise MalformedFrame(f"no pose: {error}") from None
    if not all(map(math.isfinite, (x, y, heading))):
        raise MalformedFrame("a pose that is not finite")
    return x, y, heading


def mode_name(response: Response) -> str:
    """Return the name of the onboard mode in a response to CheckMode, or "" if no mode is active (released).

    Raise ``MalformedFrame`` if it has no name.
    """
    value = parsed(response.data).get("name")
    if not isinstance(value, str):
        raise MalformedFrame(f"a mode named {value!r}")
    return value
