"""Encode and decode rosbridge v2: the operations of client and bridge, each a JSON text message. Pure: no
I/O."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

PORT = 9090

TOPICS_SERVICE = "/rosapi/topics"
TYPE_SERVICE = "/rosapi/topic_type"
TIME_SERVICE = "/rosapi/get_time"

ERROR_LEVEL = "error"


class Operation(msgspec.Struct, frozen=True, tag_field="op", omit_defaults=True):
    """One message. Only the listed fields are sent, and all others are ignored on receipt."""


class Advertise(Operation, frozen=True, tag="advertise"):
    topic: str
    type: str
    id: str | None = None


class Unadvertise(Operation, frozen=True, tag="unadvertise"):
    topic: str
    id: str | None = None


class Publish(Operation, frozen=True, tag="publish"):
    topic: str
    msg: msgspec.Raw
    id: str | None = None


class Subscribe(Operation, frozen=True, tag="subscribe"):
    topic: str
    type: str | None = None
    throttle_rate: float = 0
    """Shortest interval between two messages, milliseconds."""
    queue_length: int = 0
    id: str | None = None


class Unsubscribe(Operation, frozen=True, tag="unsubscribe"):
    topic: str
    id: str | None = None


class CallService(Operation, frozen=True, tag="call_service"):
    service: str
    args: dict[str, Any] | list[Any] = {}
    id: str | None = None


class SetLevel(Operation, frozen=True, tag="set_level"):
    """The level of status messages: none, error, warning or info."""

    level: str


class ServiceResponse(Operation, frozen=True, tag="service_response"):
    service: str
    values: Any = None
    result: bool = True
    id: str | None = None


class Status(Operation, frozen=True, tag="status"):
    level: str
    msg: str = ""
    id: str | None = None


Asked = Advertise | Unadvertise | Publish | Subscribe | Unsubscribe | CallService | SetLevel
"""The operations of a client."""

Told = Publish | ServiceResponse | Status
"""The operations of the bridge."""

_asked = msgspec.json.Decoder(Asked)
_told = msgspec.json.Decoder(Told)
_encoder = msgspec.json.Encoder()


def encode(operation: Operation) -> str:
    return _encoder.encode(operation).decode()


def publish(topic: str, message: Mapping[str, Any]) -> str:
    """Return the operation that publishes a message."""
    return encode(Publish(topic, msgspec.Raw(_encoder.encode(message))))


def response(asked: CallService, values: Any, result: bool = True) -> str:
    """Return the answer to a call. ``result`` is always present, unlike other fields, because some clients
    require it."""
    answer = {"op": "service_response", "service": asked.service, "values": values, "result": result}
    return _encoder.encode({**answer, "id": asked.id} if asked.id is not None else answer).decode()


def decode_asked(text: str | bytes) -> Asked:
    """Decode an operation of a client. Raise ``MalformedFrame``."""
    asked: Asked = _decode(_asked, text)
    return asked


def decode_incoming(text: str | bytes) -> Told:
    """Decode an operation of the bridge. Raise ``MalformedFrame``."""
    told: Told = _decode(_told, text)
    return told


def decode_message(message: msgspec.Raw) -> dict[str, Any]:
    """Return the message of a ``Publish`` as plain data. Raise ``MalformedFrame``."""
    try:
        return msgspec.json.decode(message, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise MalformedFrame(f"no message ({error})") from None


def _decode(decoder: msgspec.json.Decoder[Any], text: str | bytes) -> Any:
    if not isinstance(text, str):
        raise MalformedFrame("a binary message: no operation of rosbridge's JSON")
    try:
        return decoder.decode(text)
    except (msgspec.DecodeError, UnicodeError, RecursionError, ValueError) as error:
        raise MalformedFrame(f"no operation of rosbridge ({error})") from None
