"""A UDP socket as datagrams."""

from __future__ import annotations

import socket

import pytest
import trio

from strands_actors.drivers.common.udp_port import open_udp
from strands_actors.runtime.contract import WireDown


def robot() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    return sock


def test_datagrams_of_the_peer_and_of_nobody_else() -> None:
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


def test_a_port_that_is_taken_and_a_name_that_is_none() -> None:
    with robot() as peer:
        host, number = peer.getsockname()
        with pytest.raises(WireDown, match="who else has it"):
            open_udp("127.0.0.1", 9, host, number)
    with pytest.raises(WireDown, match="no such address"):
        open_udp("no.such.host.invalid", 9)
