"""SocketCAN: raw CAN sockets, in place of which sockets of this process stand where the kernel has none."""

from __future__ import annotations

import errno
import shlex
import socket
import subprocess
import sys

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.can_motors import can_port, stopping, wire
from strands_actors.drivers.can_motors.can_port import CanPort, CanSocket, open_interface
from strands_actors.drivers.can_motors.protocol import Frame
from strands_actors.drivers.can_motors.twin import can_line
from tests.cli.command import ROOT

from .on_interface import drive


class Hub:
    """A bus: each socket receives the frames of all others."""

    def __init__(self) -> None:
        self.ends: list[tuple[socket.socket, CanSocket]] = []

    def open(self, name: str) -> CanSocket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        theirs.setblocking(False)
        port = CanSocket(theirs, name)
        self.ends.append((ours, port))
        return port

    async def run(self) -> None:
        while True:
            await trio.sleep(0.0005)
            for ours, _ in list(self.ends):
                for data in iter(lambda sock=ours: self._take(sock), b""):  # type: ignore[misc]
                    for other, _ in self.ends:
                        if other is not ours:
                            self._give(other, data)

    def close(self) -> None:
        for ours, port in self.ends:
            ours.close()
            port.close()

    @staticmethod
    def _take(sock: socket.socket) -> bytes:
        try:
            return sock.recv(16)
        except (BlockingIOError, OSError):
            return b""

    @staticmethod
    def _give(sock: socket.socket, data: bytes) -> None:
        try:
            sock.send(data)
        except OSError:
            return


def test_an_arm_over_raw_can_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    hub = Hub()
    monkeypatch.setattr(can_port, "open_interface", hub.open)
    monkeypatch.setattr(can_line, "open_interface", hub.open)
    # This process has no priority, so a busy machine may hold it up for longer than a motor takes.
    monkeypatch.setattr(wire, "ANSWER_S", 1.0)
    monkeypatch.setattr(stopping, "CONFIRM_S", 10.0)
    monkeypatch.setattr(stopping, "TIMEOUT_S", 2.0)
    monkeypatch.setattr(wire, "TIMEOUT_S", 2.0)

    async def main() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(hub.run)
            adapter, by_wire, by_root = await drive("can0")
            nursery.cancel_scope.cancel()
        assert adapter == "socketcan"
        assert all(report.safe for report in (*by_wire, *by_root)), (by_wire, by_root)

    trio.run(main)
    hub.close()


@pytest.mark.needs("vcan")
def test_an_arm_on_a_virtual_bus_of_the_kernel() -> None:
    python = f"{shlex.quote(sys.executable)} -m tests.drivers.can_motors.on_interface vcan0"
    script = f"ip link add vcan0 type vcan && ip link set vcan0 up && {python}"
    subprocess.run(["unshare", "-rn", "sh", "-c", script], cwd=ROOT, check=True, timeout=60)


def test_an_interface_that_does_not_exist_is_named() -> None:
    with pytest.raises(WireDown, match="nocan0: "):
        open_interface("nocan0")


def test_a_bus_that_takes_no_frames_is_explained() -> None:
    class Full(socket.socket):
        def send(self, data: bytes, flags: int = 0) -> int:  # type: ignore[override]
            raise OSError(errno.ENOBUFS, "No buffer space available")

    with Full(socket.AF_UNIX, socket.SOCK_DGRAM) as full:
        port = CanPort(CanSocket(full, "can0"), "socketcan", "can0")
        with pytest.raises(WireDown, match=r"can0: the bus takes no frames.* txqueuelen 100"):
            port.send([Frame(1, bytes(8))])
