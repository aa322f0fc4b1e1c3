"""Test how addresses are parsed, which address of a host is connected, and what happens to unsent bytes of a
dead process."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Iterator

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports import tcp_port
from strands_actors.drivers.common.ports.addresses import parse_address
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp


@pytest.mark.parametrize("port", ["", ":502", "host:", "host:0", "host:70000", "[::1]:x", "/dev/ttyUSB0:x"])
def test_an_invalid_address_is_refused_with_a_valid_one(port: str) -> None:
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


def test_a_host_without_an_answer_is_named_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, "127.0.0.2", "127.0.0.3")
    with pytest.raises(WireDown, match=r"robot.local:9: cannot connect \(Connection refused\)"):
        trio.run(open_tcp, "robot.local", 9)


SETPOINT = b"setpoint" * 125
PATIENCE_S = 10.0


def take_all(peer: socket.socket) -> tuple[bytes, bool]:
    """Return the bytes that the peer reads, and whether the connection was reset after them."""
    received = b""
    with peer:
        peer.settimeout(PATIENCE_S)
        try:
            while data := peer.recv(1 << 16):
                received += data
        except ConnectionResetError:
            return received, True
    return received, False


def killed_while_it_writes(port: TcpPort) -> None:
    """Write setpoints in a child process until the peer reads no more, then kill it. This process has the
    connection, too, as a root does."""
    pid = os.fork()
    if pid == 0:
        try:
            while True:
                port.write(SETPOINT)
        except WireDown:
            os.kill(os.getpid(), signal.SIGKILL)
        finally:
            os._exit(1)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status)


@pytest.fixture
def slow_listener() -> Iterator[socket.socket]:
    """Yield the listener of a peer that does not read yet."""
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield server


def test_saf_010_unsent_bytes_of_a_killed_process_do_not_follow_a_stop(
    slow_listener: socket.socket,
) -> None:
    async def main() -> None:
        number = slow_listener.getsockname()[1]
        wires = await open_tcp("127.0.0.1", number)
        peer, _ = slow_listener.accept()
        killed_while_it_writes(wires)
        assert wires.reset_if_stalled()
        stop = await open_tcp("127.0.0.1", number)
        stops_peer, _ = slow_listener.accept()
        stop.write(b"stop")
        stop.close_in_order()
        assert take_all(stops_peer) == (b"stop", False)
        received, was_reset = take_all(peer)
        assert was_reset and len(received) < 10 * len(SETPOINT), (
            "only the bytes arrive that the system had already sent"
        )
        wires.close()

    trio.run(main)


def test_saf_010_a_peer_that_reads_nothing_is_given_up_although_another_process_has_the_connection(
    slow_listener: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_port, "UNTAKEN_S", 0.2)

    async def main() -> None:
        wires = await open_tcp("127.0.0.1", slow_listener.getsockname()[1])
        peer, _ = slow_listener.accept()
        killed_while_it_writes(wires)
        with trio.fail_after(PATIENCE_S):
            with pytest.raises(WireDown):
                await wires.read()
        received, _ = take_all(peer)
        assert len(received) < 10 * len(SETPOINT)
        wires.close()

    trio.run(main)


def test_saf_021_a_reset_ends_a_connection_for_every_process_that_has_it(listener: socket.socket) -> None:
    async def main() -> None:
        wires = await open_tcp("127.0.0.1", listener.getsockname()[1])
        peer, _ = listener.accept()
        roots = TcpPort(socket.socket(fileno=os.dup(wires.fileno())), "of the root")
        wires.write(SETPOINT)
        roots.reset()
        assert take_all(peer) == (SETPOINT, True), "the bytes that had arrived, then the reset"
        with pytest.raises(WireDown):
            wires.write(SETPOINT)
        assert wires.fileno() >= 0, "the descriptor stays open until it is closed"
        roots.close()
        wires.close()

    trio.run(main)


def test_a_connection_with_a_reading_peer_is_left_alone(listener: socket.socket) -> None:
    async def main() -> None:
        port = await open_tcp("127.0.0.1", listener.getsockname()[1])
        peer, _ = listener.accept()
        for _ in range(20):
            port.write(SETPOINT)
            assert not port.reset_if_stalled()
            time.sleep(0.002)  # noqa: ASYNC251  # the peer's system takes it
        port.write(b"stop")
        port.close_in_order()
        received, was_reset = take_all(peer)
        assert received.endswith(b"stop") and not was_reset
        assert not port.reset_if_stalled(), "a closed connection is not reset"

    trio.run(main)
