"""Test a UDP socket for datagrams."""

from __future__ import annotations

import socket

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.udp_port import listen_udp, open_udp
from tests.ports import free_port


def robot() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    return sock


def test_only_the_peers_datagrams_are_read() -> None:
    async def main() -> None:
        with robot() as peer, robot() as stranger:
            port = open_udp(*peer.getsockname())
            port.write(b"question")
            data, back = peer.recvfrom(100)
            assert data == b"question" and port.read_waiting() is None
            stranger.sendto(b"a lie", back)
            peer.sendto(b"answer", back)
            with trio.fail_after(5):
                assert await port.read() == b"answer"
            assert port.read_waiting() is None
            port.close()

    trio.run(main)


def test_a_peer_that_is_gone_is_noticed() -> None:
    async def main() -> None:
        peer = robot()
        port = open_udp(*peer.getsockname())
        peer.close()
        with trio.fail_after(5), pytest.raises(WireDown, match="not reachable"):
            port.write(b"question")
            await port.read()
        port.close()
        with pytest.raises(WireDown, match="closed"):
            port.write(b"again")

    trio.run(main)


def test_a_used_port_and_an_unknown_name() -> None:
    with robot() as peer:
        host, number = peer.getsockname()
        with pytest.raises(WireDown, match="which program uses it"):
            open_udp("127.0.0.1", 9, host, number)
    with pytest.raises(WireDown, match="no such address"):
        open_udp("no.such.host.invalid", 9)


# -- a peer that speaks first


def test_the_first_valid_sender_is_the_peer_and_others_are_ignored() -> None:
    async def main() -> None:
        number = free_port(socket.SOCK_DGRAM)
        port = await listen_udp(number)
        with robot() as peer, robot() as stranger, trio.fail_after(5):
            with pytest.raises(WireDown, match="no datagram has arrived yet"):
                port.write(b"too early")
            stranger.sendto(b"noise", ("127.0.0.1", number))
            peer.sendto(b"robot 1", ("127.0.0.1", number))
            await port.meet(lambda data: data.startswith(b"robot"))
            assert port.name == "{}:{}".format(*peer.getsockname())
            stranger.sendto(b"robot 2", ("127.0.0.1", number))
            peer.sendto(b"robot 1 again", ("127.0.0.1", number))
            assert await port.read() == b"robot 1 again"
            assert port.read_waiting() is None
            port.write(b"answer")
            assert peer.recv(100) == b"answer"
        port.close()
        with pytest.raises(WireDown, match="socket is closed"):
            await port.read()

    trio.run(main)


def test_only_datagrams_of_the_named_host_are_read() -> None:
    async def main() -> None:
        number = free_port(socket.SOCK_DGRAM)
        port = await listen_udp(number, "127.0.0.9")
        with robot() as stranger:
            stranger.sendto(b"robot", ("127.0.0.1", number))
            with trio.move_on_after(0.1) as waiting:
                await port.meet(lambda data: True)
        assert waiting.cancelled_caught
        port.close()

    trio.run(main)


def test_a_peer_that_is_gone_is_looked_for_again_on_the_same_socket() -> None:
    async def main() -> None:
        number = free_port(socket.SOCK_DGRAM)
        port = await listen_udp(number)
        for _ in range(2):
            with robot() as peer, trio.fail_after(5):
                peer.sendto(b"robot", ("127.0.0.1", number))
                await port.meet(lambda data: True)
                assert port.name == "{}:{}".format(*peer.getsockname())
                port.write(b"answer")
                assert peer.recv(100) == b"answer"
            port.write(b"to nobody")  # an unconnected socket gets no error
        port.close()

    trio.run(main)


def test_a_port_with_a_listener() -> None:
    async def main() -> None:
        number = free_port(socket.SOCK_DGRAM)
        port = await listen_udp(number)
        with pytest.raises(WireDown, match=rf"UDP port {number} cannot be opened .* Another program may use it"):
            await listen_udp(number)
        port.close()
        with pytest.raises(WireDown, match="no such address"):
            await listen_udp(number, "no.such.host.invalid")

    trio.run(main)


def test_a_flood_takes_no_turn_from_others() -> None:
    """A flood does not keep a task from being cancelled. A foreign sender's datagrams are not all dropped at
    once."""

    async def main() -> None:
        number = free_port(socket.SOCK_DGRAM)
        port = await listen_udp(number)
        with robot() as peer, robot() as stranger:
            peer.sendto(b"robot", ("127.0.0.1", number))
            await port.meet(lambda data: True)
            for _ in range(100):
                stranger.sendto(b"noise", ("127.0.0.1", number))
            peer.sendto(b"robot again", ("127.0.0.1", number))
            assert port.read_waiting() is None and port.read_waiting() == b"robot again"
            peer.sendto(b"robot again", ("127.0.0.1", number))
            for wait in (port.read, lambda: port.meet(lambda data: False)):
                with trio.CancelScope() as scope:
                    scope.cancel()
                    await wait()
                assert scope.cancelled_caught
        port.close()

    trio.run(main)
