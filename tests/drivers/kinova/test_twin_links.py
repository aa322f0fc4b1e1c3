"""Test the links of the twin as a process: notifications over TCP, and requests and notifications over UDP."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.answers import until
from tests.drivers.common.twin_process import TwinProcess

from .kortex_client import Client, Fields, blob, inside, number, read, whole
from .world import ACTION_TOPIC, ARM_STATE, CREATE_SESSION, EXECUTE_ACTION, FEEDBACK, STOP

LOGIN = blob(1, b"admin") + number(2, 60_000) + blob(3, b"admin") + number(4, 10_000)
DELAY = blob(34, number(1, 1))
"""An action that takes a second."""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path, "kinova_gen3", "kinova") as process:
        yield process


class Datagrams:
    """A client over UDP: one frame in each datagram."""

    def __init__(self, address: str, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(10.0)
        self.socket.connect((address.partition(":")[0], port))
        self.session = 0

    def __enter__(self) -> Datagrams:
        return self

    def __exit__(self, *error: object) -> None:
        self.socket.close()

    def send(self, function: int, payload: bytes = b"", message: int = 1) -> None:
        words = (1 << 28 | 1 << 24, self.session << 16 | message, 1 << 28 | function, len(payload))
        header = b"".join(bytes([at << 3 | 5]) + struct.pack("<I", word) for at, word in enumerate(words, 1))
        self.socket.send(blob(1, header) + blob(2, payload))

    def receive(self) -> tuple[int, int, int, Fields]:
        """Return the kind of a frame, the error, the function and the fields."""
        frame = read(self.socket.recv(65_535))
        info, message, service = (whole(inside(frame, 1), at) for at in (1, 2, 3))
        self.session = self.session or message >> 16
        return info >> 24 & 15, info & 0xFFFF, service & 0xFFF_FFFF, inside(frame, 2)

    def call(self, function: int, payload: bytes = b"") -> tuple[int, int, int, Fields]:
        self.send(function, payload)
        return self.receive()


def test_events_of_an_action_arrive_on_the_connection_that_subscribed(twin: TwinProcess) -> None:
    with Client(twin.port) as client, Client(twin.port) as other:
        client.log_in()
        other.log_in()
        client.call(ACTION_TOPIC)
        other.call(EXECUTE_ACTION, DELAY)
        until(lambda: client.call(ARM_STATE) is not None and len(client.notifications) > 1, "it has ended")
        assert [(topic, whole(event, 1)) for topic, event in client.notifications] == [
            (ACTION_TOPIC, 4),
            (ACTION_TOPIC, 1),
        ]
        assert other.call(ARM_STATE) and not other.notifications


@pytest.mark.parametrize("port", [10_000, 10_001])
def test_the_base_answers_on_udp_too(twin: TwinProcess, port: int) -> None:
    with Datagrams(twin.port, port) as client:
        client.send(FEEDBACK)
        assert client.receive()[:3] == (3, 1 << 12 | 12, FEEDBACK), "no session yet"
        assert client.call(CREATE_SESSION, LOGIN)[1] == 0 and client.session
        client.socket.send(b"\xff\xff")  # Bytes that are no frame get no answer.
        kind, error, function, feedback = client.call(FEEDBACK)
        assert (kind, error, function, whole(inside(feedback, 2), 2)) == (3, 0, FEEDBACK, 7)
        assert client.call(ACTION_TOPIC)[1] == 0
        client.send(EXECUTE_ACTION, DELAY)
        frames = [client.receive() for _ in range(3)]
    assert sorted(kind for kind, *_ in frames) == [3, 5, 5]
    assert [whole(fields, 1) for kind, _, _, fields in frames if kind == 5] == [4, 1]
    assert "notification" in {kind for kind, _ in twin.logged("robot")}


def test_a_session_belongs_to_its_address(twin: TwinProcess) -> None:
    with Datagrams(twin.port, 10_001) as first, Datagrams(twin.port, 10_001) as other:
        first.call(CREATE_SESSION, LOGIN)
        other.session = first.session
        assert other.call(STOP)[1] == 1 << 12 | 12
        assert first.call(STOP)[1] == 0


def answers(client: Datagrams) -> bool:
    client.socket.settimeout(0.3)
    try:
        client.call(FEEDBACK)
    except (TimeoutError, ConnectionError):
        return False
    return True


def test_udp_is_gone_with_the_cable_and_back_with_it(twin: TwinProcess) -> None:
    with Datagrams(twin.port, 10_001) as client:
        client.call(CREATE_SESSION, LOGIN)
        twin.command("unplug")
        until(lambda: not answers(client), "it is unplugged")
        twin.command("plug")
        until(lambda: answers(client), "it is back")


def test_the_password_of_a_new_user_is_not_logged(twin: TwinProcess) -> None:
    with Client(twin.port) as client:
        client.log_in()
        client.call(0x20001, blob(1, blob(2, b"eve")) + blob(2, b"hunter2"))
    text = "".join(line for _, line in twin.logged("host"))
    assert b"eve".hex() in text and b"hunter2".hex() not in text
