"""A router, and a program of ROS on its graph. Of this project the program uses nothing: keys are written by hand,
and ``rosbags`` knows the messages and their hashes."""

from __future__ import annotations

import contextlib
import itertools
import json
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""Of std_srvs/srv/Trigger, as ROS 2 Jazzy computes it. ``rosbags`` has no services."""


def _session(mode: str, role: str, endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5(f"{role}/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


@contextlib.contextmanager
def router(endpoint: str) -> Iterator[zenoh.Session]:
    """Run a router of zenoh, as ``rmw_zenohd`` is one."""
    session = _session("router", "listen", endpoint)
    try:
        yield session
    finally:
        session.close()


class Program:
    """A program of ROS: lists the graph, reads and publishes topics, calls services."""

    def __init__(self, endpoint: str, gid: bytes = b"a program of ROS") -> None:
        self._session = _session("client", "connect", endpoint)
        self._gid = gid
        self._numbers = itertools.count(1)
        self._declared: list[Any] = []

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *error: object) -> None:
        self._session.close()

    # -- the graph

    def tokens(self) -> list[list[str]]:
        replies = self._session.liveliness().get("@ros2_lv/0/**", timeout=2.0)
        return [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok]

    def nodes(self) -> set[str]:
        return {f"{parts[7].replace('%', '/')}/{parts[8]}" for parts in self.tokens() if parts[5] == "NN"}

    def names(self, kind: str) -> set[str]:
        """Return the names of topics or services that a node offers: MP, MS or SS."""
        return {parts[9].replace("%", "/") for parts in self.tokens() if parts[5] == kind}

    # -- topics

    def listen(self, topic: str, type_name: str, latched: bool = False) -> list[Any]:
        """Return a list that grows with each message of a topic."""
        received: list[Any] = []

        def on_sample(sample: zenoh.Sample) -> None:
            assert sample.attachment is not None
            attachment = sample.attachment.to_bytes()
            assert len(attachment) == 33 and attachment[16] == 16  # rmw_zenoh drops all others
            received.append(STORE.deserialize_cdr(sample.payload.to_bytes(), type_name))

        self._subscribe(self._key(topic, type_name), on_sample, latched)
        return received

    def listen_raw(self, key: str, latched: bool = False) -> list[bytes]:
        """Return a list that grows with the bytes of each message of a key."""
        received: list[bytes] = []
        self._subscribe(key, lambda sample: received.append(sample.payload.to_bytes()), latched)
        return received

    def _subscribe(self, key: str, on_sample: Callable[[zenoh.Sample], None], latched: bool) -> None:
        if latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            subscriber = zenoh.ext.declare_advanced_subscriber(self._session, key, on_sample, history=history)
            self._declared.append(subscriber)
        else:
            self._declared.append(self._session.declare_subscriber(key, on_sample))

    def publish(self, topic: str, message: Any) -> None:
        payload = STORE.serialize_cdr(message, message.__msgtype__)
        self.put(self._key(topic, message.__msgtype__), bytes(payload))

    def put(self, key: str, payload: bytes) -> None:
        """Publish the bytes of a message on a key."""
        self._session.put(key, payload, attachment=self._attachment(time.time_ns()))

    def publish_raw(self, topic: str, type_name: str, payload: bytes, attachment: bytes | None) -> None:
        self._session.put(self._key(topic, type_name), payload, attachment=attachment)

    def _key(self, topic: str, type_name: str) -> str:
        package, kind, own = type_name.split("/")
        return f"0{topic}/{package}::{kind}::dds_::{own}_/{STORE.hash_rihs01(type_name)}"

    # -- services

    def trigger(self, service: str, payload: bytes = b"\0\1\0\0\0") -> tuple[bool, str]:
        """Call a service of type std_srvs/srv/Trigger, and return ``success`` and ``message``."""
        data = self.call(f"0{service}/std_srvs::srv::dds_::Trigger_/{TRIGGER_HASH}", payload)
        (length,) = struct.unpack_from("<I", data, 8)
        return bool(data[4]), data[12 : 12 + length - 1].decode()

    def call(self, key: str, payload: bytes) -> bytes:
        """Call a service by its key, and return the bytes of the response."""
        sent = self._attachment(time.time_ns())
        replies = self._session.get(
            key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=payload,
            attachment=sent,
            timeout=30.0,
        )
        (reply,) = [reply.ok for reply in replies if reply.ok]
        assert reply.attachment is not None
        answered = reply.attachment.to_bytes()
        assert (answered[:8], answered[17:]) == (sent[:8], sent[17:])  # rmw_zenoh matches responses by these
        return bytes(reply.payload.to_bytes())

    def _attachment(self, time_ns: int) -> bytes:
        return struct.pack("<qqB", next(self._numbers), time_ns, 16) + self._gid
