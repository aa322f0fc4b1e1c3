"""A client of Foxglove's WebSocket protocol (``foxglove.sdk.v1``), without the package of Foxglove.

Messages are decoded by the schemas that the server announces: JSON, or protobuf.
"""

from __future__ import annotations

import base64
import json
import struct
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from websockets.sync.client import connect
from websockets.typing import Subprotocol

PATIENCE_S = 30.0
"""Longest wait on a busy machine."""

MESSAGE_DATA = 1
_HEAD = struct.Struct("<BIQ")


class Message(NamedTuple):
    """A message on a topic. ``log_ns`` is its time."""

    topic: str
    log_ns: int
    value: dict[str, Any]


class FoxgloveClient:
    """Subscribes to every channel that the server announces."""

    def __init__(self, url: str) -> None:
        self._connection = connect(url, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None)
        self.channels: dict[int, dict[str, Any]] = {}
        self.info: dict[str, Any] = {}
        self.messages: list[Message] = []

    def __enter__(self) -> FoxgloveClient:
        self._socket = self._connection.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.__exit__(kind, error, trace)

    @property
    def topics(self) -> set[str]:
        return {channel["topic"] for channel in self.channels.values()}

    def schema(self, topic: str) -> str:
        """Return the name of a topic's schema."""
        return next(str(each["schemaName"]) for each in self.channels.values() if each["topic"] == topic)

    def read(self, timeout_s: float) -> None:
        """Take one message of the server. Raise ``TimeoutError`` if none arrives."""
        data = self._socket.recv(timeout=timeout_s)
        if isinstance(data, bytes):
            self._on_bytes(data)
        else:
            self._on_text(json.loads(data))

    def until(self, look: Callable[[Message], bool], what: str, within_s: float = PATIENCE_S) -> Message:
        """Return the first message, of those received before or later, for which ``look`` is true."""
        deadline, checked = time.monotonic() + within_s, 0
        while True:
            for message in self.messages[checked:]:
                if look(message):
                    return message
            checked = len(self.messages)
            left_s = deadline - time.monotonic()
            assert left_s > 0, f"not within {within_s:g} s: {what}. There are {sorted(self.topics)}"
            try:
                self.read(left_s)
            except TimeoutError:
                continue

    def _on_text(self, message: dict[str, Any]) -> None:
        if message["op"] == "serverInfo":
            self.info = message
        elif message["op"] == "advertise":
            for channel in message["channels"]:
                self.channels[channel["id"]] = channel
            subscriptions = [{"id": each["id"], "channelId": each["id"]} for each in message["channels"]]
            self._socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    def _on_bytes(self, data: bytes) -> None:
        kind, subscription, log_ns = _HEAD.unpack_from(data)
        if kind == MESSAGE_DATA:
            channel = self.channels[subscription]
            self.messages.append(Message(channel["topic"], log_ns, decoded(channel, data[_HEAD.size :])))


def decoded(channel: dict[str, Any], payload: bytes) -> dict[str, Any]:
    """Return the message of a channel as a dict, by the schema that the server announced."""
    if channel["encoding"] == "json":
        value: dict[str, Any] = json.loads(payload)
        return value
    assert channel["encoding"] == "protobuf", channel["encoding"]
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))()
    message.ParseFromString(payload)
    return json_format.MessageToDict(message, preserving_proto_field_name=True)
