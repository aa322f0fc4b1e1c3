"""The names and attachments of rmw_zenoh: keys of topics and services, liveliness tokens. Pure.

A program of ROS subscribes to a key with the topic's name, its type and the hash of its type. It learns from
liveliness tokens which nodes, publishers, subscriptions and services exist. A sample without an attachment is
dropped by rmw_zenoh.
"""

from __future__ import annotations

import enum
import hashlib
import re
import struct
from typing import NamedTuple

from .type_hash import UNSUPPORTED, dds_name, type_hash

TOKENS = "@ros2_lv"
GID_BYTES = 16
ATTACHMENT_BYTES = 33

_EMPTY = "%"
"""An empty part of a token. A slash within a part is written with the same sign."""
_FIRST = re.compile(r"[^A-Za-z_]")
_OTHER = re.compile(r"[^A-Za-z0-9_]+")
_ROS_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_HEAD = struct.Struct("<qqB")


class Entity(enum.StrEnum):
    """The kind of an endpoint, as it stands in its liveliness token."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


class Qos(enum.StrEnum):
    """Quality of service, as it stands in a token.

    The parts are reliability, durability, history and depth, deadline, lifespan, liveliness. A part with the
    default of rmw_zenoh is left out: reliable, and transient local.
    """

    DEFAULT = ":2:,10:,:,:,,"  # reliable, volatile, keep the last 10: the default of rclcpp and rclpy
    SENSOR = "2:2:,5:,:,:,,"  # best effort, volatile, keep the last 5
    LATCHED = "::,1:,:,:,,"  # reliable, transient local, keep the last: later subscribers get it, too


class Dialect(NamedTuple):
    """What all keys of one graph have in common.

    Attributes:
        domain: The number of the ROS domain.
        hashed: True for ROS 2 Jazzy and later. False for Humble, which has no type hashes.
    """

    domain: int = 0
    hashed: bool = True

    def hash_of(self, type_name: str) -> str:
        return type_hash(type_name) if self.hashed else UNSUPPORTED

    def key(self, topic: str, type_name: str) -> str:
        """Return the key of a topic or service. ``topic`` begins with a slash."""
        return f"{self.domain}/{topic.strip('/')}/{dds_name(type_name)}/{self.hash_of(type_name)}"


class NodeName(NamedTuple):
    """A node in a session.

    Attributes:
        session: The identifier of the zenoh session.
        number: The number of the node in its session.
        namespace: Empty, or begins with a slash.
        name: The name of the node.
    """

    session: str
    number: int
    namespace: str
    name: str

    def token(self, dialect: Dialect) -> str:
        return self._head(dialect, self.number, Entity.NODE)

    def endpoint_token(
        self, dialect: Dialect, number: int, kind: Entity, topic: str, type_name: str, qos: Qos
    ) -> str:
        """Return the token of an endpoint of this node.

        Args:
            dialect: The graph.
            number: The number of the endpoint in its session.
            kind: The kind of the endpoint.
            topic: The full name of the topic or service, with a slash in front.
            type_name: Its type.
            qos: Its quality of service.
        """
        head = self._head(dialect, number, kind)
        return f"{head}/{_mangled(topic)}/{dds_name(type_name)}/{dialect.hash_of(type_name)}/{qos}"

    def _head(self, dialect: Dialect, number: int, kind: Entity) -> str:
        place = f"{TOKENS}/{dialect.domain}/{self.session}/{self.number}/{number}/{kind}"
        return f"{place}/{_EMPTY}/{_mangled(self.namespace)}/{self.name}"


def _mangled(name: str) -> str:
    return name.replace("/", _EMPTY) or _EMPTY


class Endpoint(NamedTuple):
    """An endpoint of any node, read from its token."""

    session: str
    kind: str
    node: str  # with its namespace and a slash in front
    topic: str


def read_token(token: str) -> Endpoint | None:
    """Return the endpoint that a token announces. None for a node's token, and for any other key."""
    parts = token.split("/")
    if len(parts) < 12 or parts[0] != TOKENS:
        return None
    namespace = parts[7].replace(_EMPTY, "/").rstrip("/")
    return Endpoint(parts[2], parts[5], f"{namespace}/{parts[8]}", parts[9].replace(_EMPTY, "/"))


def gid_of(token: str) -> bytes:
    """Return an identifier for an endpoint. ROS compares identifiers, and reads nothing from them."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()


class Attachment(NamedTuple):
    """The attachment of a sample, a request or a response.

    Attributes:
        sequence: The number of the sample. A response repeats the number of its request.
        sent_ns: The time of sending on the sender's wall clock, in nanoseconds.
        gid: The identifier of the publisher. A response repeats that of its client.
    """

    sequence: int
    sent_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return _HEAD.pack(self.sequence, self.sent_ns, GID_BYTES) + self.gid


def read_attachment(data: bytes | None) -> Attachment | None:
    """Return the attachment in these bytes; None if there is none, or if it is malformed."""
    if data is None or len(data) != ATTACHMENT_BYTES:
        return None
    sequence, sent_ns, length = _HEAD.unpack_from(data)
    return Attachment(sequence, sent_ns, data[_HEAD.size :]) if length == GID_BYTES else None


def ros_name(name: str) -> str:
    """Return a robot's name as ROS accepts it: letters, digits and ``_``, and no digit in front."""
    plain = _OTHER.sub("_", name)
    return f"_{plain}" if _FIRST.match(plain) or not plain else plain


ENDPOINTS = ("tcp/", "unixsock-stream/")
"""How the endpoint of a graph's router begins."""


def problem_of(namespace: str, router: str) -> str:
    """Return what is wrong with the options of a program on a graph, and the remedy; empty if nothing is.

    Args:
        namespace: The namespace of its nodes.
        router: The endpoint of the graph's zenoh router.
    """
    if not is_namespace(namespace):
        return f"{namespace!r} is no namespace of ROS. Give letters, digits and _, such as /lab"
    if not router.startswith(ENDPOINTS):
        return f"{router!r} is no endpoint of a router. Give one such as tcp/localhost:7447"
    return ""


def is_namespace(text: str) -> bool:
    """Return True for an empty text, and for names of ROS with a slash in front of each."""
    return not text or (text[0] == "/" and all(_ROS_NAME.match(part) for part in text[1:].split("/")))
