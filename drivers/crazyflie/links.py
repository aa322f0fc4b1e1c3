"""Links to a Crazyflie that carry CRTP packets: UDP, TCP and serial lines. For radio and USB see
``usb_links``."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Protocol

import trio

from strands_actors.contract.wire import Permit, PermitDenied, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.serial_port import BytePort, adopt_serial, open_serial
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.drivers.common.ports.udp_port import UdpPort, open_udp

from . import cpx
from .config import Endpoint

BAUD = 576_000
READY_S = 2.0
"""Longest time until the other end of a serial line is ready."""
UNSOLICITED_S = 0.3
"""How long to wait for an unsolicited ready signal. A drone that has just started sends it ten times a second."""
RESEND_S = 0.25
"""Pause before an unacknowledged request is written again."""


class Link(Protocol):
    """A connection that carries CRTP packets. All methods raise ``WireDown`` once it is lost."""

    name: str
    prompt: bool = True
    """True if ``write`` and ``read_waiting`` never wait."""

    outlives_a_loss: bool = False
    """True if a lost link may work again, because it has no connection that could be dead."""

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        """Send a packet. ``permit`` is the last check whether it may still be sent."""
        ...

    async def read(self) -> bytes:
        """Wait for the next packet. Only one task at a time may call this."""
        ...

    def read_waiting(self) -> bytes | None:
        """Return a packet that has already arrived, else None. Never waits."""
        ...

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Do the background work of the link, if it has any, until cancelled."""
        task_status.started()

    def handover(self) -> Sequence[int]:
        """Return file descriptors with which another process can write to the robot. They are valid until
        ``close``."""
        return ()

    def close(self) -> None: ...


class UdpLink(Link):
    outlives_a_loss = True

    def __init__(self, port: UdpPort) -> None:
        self._port = port
        self.name = f"udp://{port.name}"

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        if permit is not None:
            permit.check()
            self._port.write(packet)
            return
        try:
            self._port.write(packet)
        except WireDown:
            # Write once more: the error may belong to an earlier packet, and is cleared by now.
            self._port.write(packet)

    async def read(self) -> bytes:
        return await self._port.read()

    def read_waiting(self) -> bytes | None:
        return self._port.read_waiting()

    def close(self) -> None:
        self._port.close()


class TcpLink(Link):
    """CPX packets over TCP."""

    def __init__(self, port: TcpPort) -> None:
        self._port = port
        self._decoder = cpx.TcpDecoder()
        self._waiting: deque[bytes] = deque()
        self.name = f"tcp://{port.name}"

    def bridge(self) -> None:
        """Request that the robot sends its CRTP packets inside CPX."""
        self._port.write(cpx.tcp_frame(cpx.packet(cpx.Function.SYSTEM, cpx.BRIDGE)))

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        frame = cpx.tcp_frame(cpx.packet(cpx.Function.CRTP, packet))
        if permit is not None:
            permit.check()
        self._port.write(frame)

    async def read(self) -> bytes:
        while (packet := self.read_waiting()) is None:
            self._take(await self._port.read())
        return packet

    def read_waiting(self) -> bytes | None:
        if not self._waiting:
            data = self._port.read_waiting()
            if data:
                self._take(data)
        return self._waiting.popleft() if self._waiting else None

    def _take(self, data: bytes) -> None:
        try:
            packets = self._decoder.feed(data)
        except MalformedFrame as malformed:
            raise WireDown(f"{self.name}: unreadable bytes arrived ({malformed}). Reconnect") from None
        self._waiting += carried(packets)

    def close(self) -> None:
        self._port.close()


class SerialLink(Link):
    """CPX over a serial line. A setpoint waits until the robot has acknowledged the previous frame. A frame of
    a stop does not wait."""

    def __init__(self, port: BytePort, name: str) -> None:
        self._port = port
        self._decoder = cpx.UartDecoder()
        self._waiting: deque[bytes] = deque()
        self._ready = True
        self.name = name

    async def bridge(self) -> None:
        """Synchronise with the robot, and request its CRTP packets inside CPX. Raise ``WireDown``.

        If another process has talked to the robot since it was switched on, the robot does not signal by itself
        that it is ready. It does so after it has received a frame.
        """
        self._ready = False
        with trio.move_on_after(READY_S):
            await self._until_ready(UNSOLICITED_S)
            self._port.write(cpx.READY)
            for request in (cpx.BRIDGE, cpx.CLIENT):
                self._ready = False
                while not self._ready:
                    self._port.write(cpx.uart_frame(cpx.packet(cpx.Function.SYSTEM, request)))
                    await self._until_ready(RESEND_S)
            return
        raise WireDown(f"{self.name}: no Crazyflie answers on this line. Check the line and its rate, {BAUD} baud")

    async def _until_ready(self, within_s: float) -> None:
        with trio.move_on_after(within_s):
            while not self._ready:
                self._take(await self._port.read())

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        frame = cpx.uart_frame(cpx.packet(cpx.Function.CRTP, packet))
        self._take(self._port.take())
        if permit is not None:
            if not self._ready:
                raise PermitDenied("the robot has not acknowledged the previous frame")
            permit.check()
        self._ready = False
        self._port.write(frame)

    async def read(self) -> bytes:
        while (packet := self.read_waiting()) is None:
            self._take(await self._port.read())
        return packet

    def read_waiting(self) -> bytes | None:
        if not self._waiting:
            self._take(self._port.take())
        return self._waiting.popleft() if self._waiting else None

    def _take(self, data: bytes) -> None:
        packets = self._decoder.feed(data)
        full = [packet for packet in packets if packet]
        self._ready = self._ready or len(full) < len(packets)
        for _ in full:
            self._port.write(cpx.READY)
        self._waiting += carried(full)

    async def hung_up(self) -> None:
        """Wait until the serial adapter is unplugged."""
        await self._port.hung_up()

    def handover(self) -> Sequence[int]:
        return (self._port.fileno(),)

    def close(self) -> None:
        self._port.close()


def adopt_line(descriptor: int, path: str) -> SerialLink:
    """Make a link from the file descriptor of a serial port that another process has opened
    (``SerialLink.handover``)."""
    return SerialLink(adopt_serial(descriptor, path), f"serial://{path}")


async def open_line(path: str) -> SerialLink:
    """Open a serial line. Raise ``WireDown``."""
    line = SerialLink(open_serial(path, BAUD), f"serial://{path}")
    try:
        await line.bridge()
    except BaseException:
        line.close()
        raise
    return line


async def open_link(endpoint: Endpoint) -> Link:
    """Open a link that does not need USB. Raise ``WireDown``."""
    match endpoint.kind:
        case "udp":
            return UdpLink(open_udp(endpoint.host, endpoint.number))
        case "tcp":
            tcp = TcpLink(await open_tcp(endpoint.host, endpoint.number))
            tcp.bridge()
            return tcp
        case "serial":
            return await open_line(endpoint.path)
    raise WireDown(f"{endpoint.kind}: only the process that flies the drone can open a USB device")


def carried(packets: Sequence[bytes]) -> list[bytes]:
    """Return the CRTP packets that are inside CPX packets. All other packets are dropped."""
    crtp = []
    for packet in packets:
        try:
            function, data = cpx.parse(packet)
        except MalformedFrame:
            continue
        if function == cpx.Function.CRTP and data:
            crtp.append(data)
    return crtp
