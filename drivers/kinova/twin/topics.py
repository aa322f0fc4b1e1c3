"""Send notifications to the clients that have subscribed to them.

A notification has the number of its subscription in place of the number of a request. The vendor's client finds the
callback by this number.
"""

from __future__ import annotations

import time
from typing import NamedTuple, Protocol, runtime_checkable

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import Frame, Kind, SubError

from . import messages as m
from .errors import CallFailed
from .functions import Function

TOPICS = (
    Function.CONFIGURATION_CHANGE_TOPIC,
    Function.SEQUENCE_INFO_TOPIC,
    Function.ACTION_TOPIC,
    Function.SERVOING_MODE_TOPIC,
    Function.ARM_STATE_TOPIC,
)


@runtime_checkable
class Subscriber(Protocol):
    """A connection that can send frames without a request."""

    def notify(self, frame: Frame) -> None: ...


class Subscription(NamedTuple):
    topic: int
    connection: object
    session: int


class Topics:
    """All subscriptions of one base."""

    def __init__(self) -> None:
        self._subscriptions: dict[int, Subscription] = {}
        self._number = 0

    def subscribe(self, topic: int, connection: object, session: int) -> bytes:
        """Return the ``NotificationHandle``."""
        self._number = self._number % 0xFFFF + 1
        self._subscriptions[self._number] = Subscription(topic, connection, session)
        return pb.varint_field(1, self._number)

    def unsubscribe(self, payload: bytes) -> None:
        if self._subscriptions.pop(m.identifier_of(payload), None) is None:
            raise CallFailed(SubError.ENTITY_NOT_FOUND, "no such subscription")

    def forget(self, session: int) -> None:
        """Remove the subscriptions of a session that has ended."""
        for number, each in list(self._subscriptions.items()):
            if each.session == session:
                del self._subscriptions[number]

    def clear(self) -> None:
        self._subscriptions.clear()

    def publish(self, topic: int, payload: bytes) -> None:
        for number, each in list(self._subscriptions.items()):
            if each.topic == topic and isinstance(each.connection, Subscriber):
                each.connection.notify(Frame(Kind.NOTIFICATION, topic, number, each.session, payload))


def timestamp() -> bytes:
    """Return a ``Timestamp`` of the present time."""
    now_us = time.time_ns() // 1000
    return pb.varint_field(1, now_us // 1_000_000) + pb.varint_field(2, now_us % 1_000_000)
