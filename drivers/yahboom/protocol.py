"""Encode and decode rosbridge v2. Each message of client or bridge is named an operation, and is a
JSON text. Pure: no I/O."""

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
    """One rosbridge message. Only the declared fields are sent. Other fields are ignored on
    receipt."""


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
    """Sets which status messages rosbridge sends: none, or those from error, warning or info
    upwards."""

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


ClientOperation = Advertise | Unadvertise | Publish | Subscribe | Unsubscribe | CallService | SetLevel
"""The operations of a client."""

BridgeOperation = Publish | ServiceResponse | Status
"""The operations of the bridge."""

_client_decoder = msgspec.json.Decoder(ClientOperation)
_bridge_decoder = msgspec.json.Decoder(BridgeOperation)
_encoder = msgspec.json.Encoder()


def encode(operation: Operation) -> str:
    return _encoder.encode(operation).decode()


def publish(topic: str, message: Mapping[str, Any]) -> str:
    """Encode the operation that publishes a message."""
    return encode(Publish(topic, msgspec.Raw(_encoder.encode(message))))


def response(call: CallService, values: Any, result: bool = True) -> str:
    """Encode the answer to a service call. ``result`` is always present, because some clients
    require it."""
    answer = {"op": "service_response", "service": call.service, "values": values, "result": result}
    return _encoder.encode({**answer, "id": call.id} if call.id is not None else answer).decode()


def decode_client_operation(text: str | bytes) -> ClientOperation:
    """Decode a message that a client sends to rosbridge. Raise ``MalformedFrame``."""
    operation: ClientOperation = _decode(_client_decoder, text)
    return operation


def decode_incoming(text: str | bytes) -> BridgeOperation:
    """Decode an operation that rosbridge sends. Raise ``MalformedFrame``."""
    operation: BridgeOperation = _decode(_bridge_decoder, text)
    return operation


def decode_message(message: msgspec.Raw) -> dict[str, Any]:
    """Return the message inside a ``Publish`` operation as plain data. Raise ``MalformedFrame``."""
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
