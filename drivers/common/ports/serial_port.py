"""A serial port that reads and writes bytes. A write is complete or raises; a read waits under trio.

The process that opens the device owns it, by an exclusive lock on the open file. Another process can use a
duplicate of the descriptor, which has the same open file, the same lock and the same speed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
from typing import Protocol

# This import is not delayed until a port is opened. A stop may have to open an unplugged port again, and must not
# wait for an import.
import serial
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

from .port_users import users_of

_READ_SIZE = 4096


class BytePort(Protocol):
    """The methods of a serial port that a bus needs. Every call raises ``WireDown`` once the port is lost."""

    def write(self, data: bytes) -> None:
        """Send all of ``data`` now, or raise. No part of it is sent later, because a late frame may do harm."""
        ...

    async def read(self) -> bytes:
        """Wait until at least one byte has arrived, and return the received bytes."""
        ...

    def take(self) -> bytes:
        """Return the received bytes that were not read yet. Never waits."""
        ...

    def discard_input(self) -> None:
        """Drop the received bytes that were not read yet."""
        ...

    def discard_output(self) -> None:
        """Drop the written bytes that were not sent yet. This may leave an incomplete frame on the bus."""
        ...

    async def hung_up(self) -> None:
        """Return once the device is lost. No received byte is read."""
        ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class SerialPort:
    """A ``BytePort`` on the descriptor of an open serial device. It owns the descriptor.

    Args:
        fd: The descriptor, in non-blocking mode.
        name: The name of the port for messages.
        owner: True if this process has opened the device. ``close`` then releases the lock.
    """

    def __init__(self, fd: int, name: str, owner: bool) -> None:
        self._fd = fd
        self._owner = owner
        self.name = name

    def write(self, data: bytes) -> None:
        try:
            written = os.write(self._fd, data)
        except BlockingIOError:
            written = 0
        except OSError as error:
            raise self._wire_down(error) from None
        if written != len(data):
            raise WireDown(
                f"{self.name}: output is blocked (sent {written} of {len(data)} bytes). "
                "Check that the adapter is alive, then reconnect"
            )

    async def read(self) -> bytes:
        while True:
            try:
                await trio.lowlevel.wait_readable(self._fd)
                data = os.read(self._fd, _READ_SIZE)
            except BlockingIOError:
                continue
            except (OSError, ValueError) as error:
                raise self._wire_down(error) from None
            if not data:
                raise self._wire_down(None)
            return data

    def take(self) -> bytes:
        try:
            return os.read(self._fd, _READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._wire_down(error) from None

    def discard_input(self) -> None:
        self._flush(termios.TCIFLUSH)

    def discard_output(self) -> None:
        self._flush(termios.TCOFLUSH)

    async def hung_up(self) -> None:
        if not hasattr(select, "epoll"):
            # Without epoll, a lost device looks like received data.
            await trio.sleep_forever()
        with select.epoll() as poll:
            try:
                # epoll reports a lost device even if no event is requested.
                poll.register(self._fd, 0)
            except PermissionError:
                # The descriptor may be a plain file, as in some tests. Such a file is never lost.
                await trio.sleep_forever()
            await trio.lowlevel.wait_readable(poll.fileno())

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        if self._fd < 0:
            return
        if self._owner:
            # Another process may have a duplicate of the descriptor, which would keep the lock. Then this process
            # could not open the device again.
            with contextlib.suppress(OSError):
                fcntl.flock(self._fd, fcntl.LOCK_UN)
        else:
            # The library of the process that opened the device may have locked it against every other user
            # (TIOCEXCL). A process that was killed has not released this lock, and it lasts for as long as any
            # program has the device open.
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
        os.close(self._fd)
        self._fd = -1

    def _flush(self, queue: int) -> None:
        try:
            termios.tcflush(self._fd, queue)
        except (termios.error, ValueError) as error:
            raise self._wire_down(error) from None

    def _wire_down(self, error: Exception | None) -> WireDown:
        if self._fd < 0:
            return WireDown(f"{self.name}: the port is closed. Reconnect")
        reason = error.args[-1] if error and error.args else "end of file"
        return WireDown(f"{self.name}: the port is gone ({reason}). Check cable and power, then reconnect")


def open_serial(path: str, baud: int) -> SerialPort:
    """Open a serial device in raw mode (8N1), with an exclusive lock.

    Args:
        path: The path of the device.
        baud: Bits per second.

    Raises:
        WireDown: The device cannot be opened, or another program uses it.
    """
    try:
        device = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        RESERVE.lacked(error)
        if "lock" in str(error) or getattr(error, "errno", None) == errno.EBUSY:
            raise WireDown(in_use(path, users_of(path))) from None
        raise WireDown(
            f"{path}: cannot open at {baud} baud ({error}). Check port=, and which program uses it"
        ) from None
    try:
        fd = os.dup(device.fileno())  # The lock belongs to the open file, so the duplicate keeps it.
    finally:
        device.close()
    port = SerialPort(fd, path, owner=True)
    try:
        _wait_for_bytes(fd)
    except termios.error as error:
        port.close()
        raise WireDown(f"{path}: cannot be configured ({error.args[-1]}). Check port=") from None
    return port


def in_use(path: str, users: tuple[str, ...]) -> str:
    """Return the error message for a port that other programs use. ``users`` are those programs, as far as
    known."""
    by = f" by {', '.join(users)}" if users else ""
    return f"{path}: in use{by}. End that first, or give another port="


def adopt_serial(fd: int, name: str = "serial port") -> SerialPort:
    """Make a port from a duplicate of a descriptor. The process that opened the device has already configured the
    device."""
    return SerialPort(fd, name, owner=False)


def _wait_for_bytes(fd: int) -> None:
    """Configure the device so that a read waits for at least one byte.

    pyserial sets VMIN to 0. A read then returns b"" both if there is no data and if the device was unplugged.
    """
    os.set_blocking(fd, False)
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    attributes[6][termios.VTIME] = 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
