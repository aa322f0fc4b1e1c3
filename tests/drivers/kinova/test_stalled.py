"""Test a base that reads no more when the wire process dies: its unsent bytes must not arrive after a stop.
This needs real sockets, since the system keeps the unsent bytes."""

from __future__ import annotations

import os
import socket

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.drivers.kinova.driver import Kinova
from strands_actors.drivers.kinova.protocol import Call, Decoder, Frame, Kind
from strands_actors.drivers.kinova.stop_channel import KinovaStopChannel
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health.heartbeat import new_page

SPEEDS = Frame(Kind.REQUEST, Call.SEND_JOINT_SPEEDS, 1, 1, b"speeds" * 20).encode()


def calls_in(data: bytes) -> list[int]:
    return [frame.call for frame in Decoder().feed(data)]


@pytest.mark.parametrize("stalled", [True, False])
def test_saf_010_a_stop_is_not_written_behind_joint_speeds_that_the_base_does_not_take(stalled: bool) -> None:
    async def main() -> None:
        with socket.socket() as base:
            base.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            base.bind(("127.0.0.1", 0))
            base.listen()
            host, number = base.getsockname()
            wires = await open_tcp(host, number)
            peer, _ = base.accept()
            wires.write(SPEEDS)
            with pytest.raises(WireDown, match="output is blocked"):
                while stalled:
                    wires.write(SPEEDS)
                raise WireDown("output is blocked: not meant to be")
            driver = Kinova("kinova_gen3", f"{host}:{number}", {})
            channel = KinovaStopChannel(driver.config, (os.dup(wires.fileno()), new_page()), MonotonicClock())
            wires.close()  # its process has died; the root still has the connection
            await channel.make_safe("stop")
            channel.close()
            peer.settimeout(5.0)
            received = b""
            with peer, pytest.raises(ConnectionResetError):
                while True:
                    received += peer.recv(1 << 16)
            assert len(received) < 100 * len(SPEEDS)
            assert (Call.STOP in calls_in(received)) == (not stalled), (
                "the stop is sent only if the connection is not stalled"
            )

    trio.run(main)
