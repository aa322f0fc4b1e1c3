"""Addresses as they are written, and a connection to the first of a host's addresses that takes
it."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.tcp_port import open_tcp, parse_address


@pytest.mark.parametrize("port", ["", ":502", "host:", "host:0", "host:70000", "[::1]:x", "/dev/ttyUSB0:x"])
def test_what_is_no_address_is_refused_with_what_would_be(port: str) -> None:
    with pytest.raises(ValueError, match="Give an address"):
        parse_address(port, 502)


@pytest.mark.parametrize(
    ("port", "address"),
    [
        ("gripper.local", ("gripper.local", 502)),
        ("192.0.2.10:1502", ("192.0.2.10", 1502)),
        ("::1", ("::1", 502)),
        ("[::1]", ("::1", 502)),
        ("[::1]:1502", ("::1", 1502)),
    ],
)
def test_addresses(port: str, address: tuple[str, int]) -> None:
    assert parse_address(port, 502) == address


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def answer_with(monkeypatch: pytest.MonkeyPatch, *hosts: str) -> None:
    async def getaddrinfo(host: str, port: int, **_: object) -> list[tuple[object, ...]]:
        await trio.lowlevel.checkpoint()
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (found, port)) for found in hosts]

    monkeypatch.setattr(trio.socket, "getaddrinfo", getaddrinfo)


def test_a_host_whose_first_address_refuses_is_reached_at_the_next(
    listener: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer_with(monkeypatch, "127.0.0.2", "127.0.0.1")

    async def main() -> None:
        port = await open_tcp("robot.local", listener.getsockname()[1])
        assert port.peer_host == "127.0.0.1"
        port.close()

    trio.run(main)


def test_a_host_that_nobody_answers_at_is_told_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, "127.0.0.2", "127.0.0.3")
    with pytest.raises(WireDown, match=r"robot.local:9: cannot connect \(Connection refused\)"):
        trio.run(open_tcp, "robot.local", 9)
