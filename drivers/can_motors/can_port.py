"""A CAN bus: a network interface of the kernel (SocketCAN), or an adapter behind a serial port."""

from __future__ import annotations

import errno
import re
import socket
from collections.abc import Callable, Iterable

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import check_device
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.common.ports.serial_port import BytePort, SerialPort, open_serial
from strands_actors.kernel.processes.reserve import RESERVE

from .adapters import ADAPTERS
from .protocol import Frame

OpenPort = Callable[[str, int], BytePort]


def is_interface(port: str) -> bool:
    """Return True if ``port`` names a network interface, such as ``can0``, and no serial device."""
    return "/" not in port


def check_bus(port: str) -> None:
    """Raise ``ValueError`` unless ``port`` can name a network interface or a serial device."""
    if not is_interface(port):
        check_device(port)
    elif not re.fullmatch(r"[A-Za-z]\w{0,14}", port, re.ASCII):
        raise ValueError(f"port is {port!r}. Give a CAN interface (can0), or the path of an adapter (/dev/ttyACM0)")


class CanSocket:
    """A ``BytePort`` on a raw CAN socket. Each write and each read is one frame."""

    def __init__(self, sock: socket.socket, name: str) -> None:
        self._sock = sock
        self.name = name

    def write(self, data: bytes) -> None:
        try:
            for start in range(0, len(data), 16):
                self._sock.send(data[start : start + 16])
        except OSError as error:
            raise self._down(error) from None

    async def read(self) -> bytes:
        while True:
            try:
                await trio.lowlevel.wait_readable(self._sock)
                return self._sock.recv(16)
            except BlockingIOError:
                continue
            except (OSError, ValueError) as error:
                raise self._down(error) from None

    def take(self) -> bytes:
        try:
            return self._sock.recv(16)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._down(error) from None

    def discard_input(self) -> None:
        while self.take():
            pass

    def discard_output(self) -> None:
        """Do nothing. The kernel sends whole frames only."""

    async def hung_up(self) -> None:
        await trio.sleep_forever()

    def fileno(self) -> int:
        return self._sock.fileno()

    def close(self) -> None:
        self._sock.close()

    def _down(self, error: Exception) -> WireDown:
        if isinstance(error, OSError) and error.errno == errno.ENOBUFS:
            remedy = f"Check that the motors have power, and set `ip link set {self.name} txqueuelen 100`"
            return WireDown(f"{self.name}: the bus takes no frames. {remedy}")
        reason = error.args[-1] if error.args else "closed"
        return WireDown(f"{self.name}: the CAN interface is gone ({reason}). Check the adapter, then reconnect")


def open_interface(name: str) -> CanSocket:
    """Open a CAN interface of the kernel. Raise ``WireDown`` if it does not exist, or if it is down."""
    if not hasattr(socket, "AF_CAN"):
        raise WireDown(f"{name}: this system has no CAN interfaces. Use an adapter at a serial port")
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            sock.setblocking(False)
            sock.bind((name,))
        except BaseException:
            sock.close()
            raise
    except OSError as error:
        RESERVE.lacked(error)
        raise WireDown(
            f"{name}: cannot open ({error.strerror}). Check port=, and start the interface: "
            f"`ip link set {name} up type can bitrate 1000000`"
        ) from None
    return CanSocket(sock, name)


class CanPort:
    """One CAN bus: it sends and receives frames. Every call raises ``WireDown`` once the bus is lost."""

    def __init__(self, port: BytePort, adapter: str, name: str) -> None:
        self.port = port
        self.adapter = ADAPTERS[adapter]()
        self._budget = ReceiveBudget(name, pieces=256)

    @classmethod
    def open(cls, name: str, adapter: str, baud: int, open_port: OpenPort = open_serial) -> CanPort:
        """Open a bus by its name: a network interface or a serial device."""
        bus = cls(open_interface(name) if adapter == "socketcan" else open_port(name, baud), adapter, name)
        bus.write(bus.adapter.OPEN)
        return bus

    @classmethod
    def adopt(cls, descriptor: int, name: str, adapter: str) -> CanPort:
        """Make a bus from a duplicate of a descriptor that another process has opened."""
        if adapter == "socketcan":
            return cls(CanSocket(socket.socket(fileno=descriptor), name), adapter, name)
        return cls(SerialPort(descriptor, name, owner=False), adapter, name)

    def resync(self) -> None:
        """Drop unsent output, and end an incomplete frame in the adapter, before a stop."""
        self.port.discard_output()
        self.write(self.adapter.END)

    def write(self, data: bytes) -> None:
        """Send bytes to the adapter itself."""
        if data:
            self.port.write(data)

    def send(self, frames: Iterable[Frame]) -> None:
        """Send frames at once, or raise."""
        self.port.write(b"".join(map(self.adapter.encode, frames)))

    def received(self) -> Iterable[Frame]:
        """Return the frames that have arrived. Never waits."""
        for data in self._budget.turn(lambda: self.port.take() or None):
            yield from self.adapter.feed(data)

    def fileno(self) -> int:
        return self.port.fileno()

    def close(self) -> None:
        self.port.close()
