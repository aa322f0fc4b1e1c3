"""A serial port as bytes. A write is complete or fails; a read waits under trio.

The port that opens the device owns it, by an exclusive lock on the open file. Another process can
adopt a duplicate of the descriptor: it has the same open file, the same lock and the same speed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
from typing import Protocol

import serial  # Imported here, because a root with an unplugged port opens it again, and a stop imports nothing.
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

from .port_users import users_of

_READ_SIZE = 4096


class BytePort(Protocol):
    """The port that a bus needs. Every call raises ``WireDown`` once the port is gone."""

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once, or raise. Nothing is kept for later, since that frame would
        leave late."""
        ...

    async def read(self) -> bytes:
        """Return at least one byte, as soon as there is one."""
        ...

    def take(self) -> bytes:
        """Return the bytes that were received and not read yet. Never waits."""
        ...

    def discard_input(self) -> None:
        """Drop the bytes that were received and not read yet."""
        ...

    def discard_output(self) -> None:
        """Drop the bytes that were written and have not left yet. This may cut a frame in two."""
        ...

    async def hung_up(self) -> None:
        """Return once the device is gone. No received byte is consumed."""
        ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class SerialPort:
    """A ``BytePort`` over the descriptor of an open terminal device. It owns the descriptor.

    Args:
        fd: The descriptor, not blocking.
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
            raise self._gone(error) from None
        if written != len(data):
            raise WireDown(
                f"{self.name}: output is blocked ({written} of {len(data)} bytes left). "
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
                raise self._gone(error) from None
            if not data:
                raise self._gone(None)
            return data

    def take(self) -> bytes:
        try:
            return os.read(self._fd, _READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from None

    def discard_input(self) -> None:
        self._flush(termios.TCIFLUSH)

    def discard_output(self) -> None:
        self._flush(termios.TCOFLUSH)

    async def hung_up(self) -> None:
        if not hasattr(select, "epoll"):
            await trio.sleep_forever()  # Without epoll a hang-up looks like data.
        with select.epoll() as poll:
            try:
                poll.register(self._fd, 0)  # epoll always reports a hang-up.
            except PermissionError:
                await trio.sleep_forever()  # A plain file, as in tests, never hangs up.
            await trio.lowlevel.wait_readable(poll.fileno())

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        if self._fd < 0:
            return
        if self._owner:
            # A duplicate in another process would keep the lock, and this process could not open the
            # device again.
            with contextlib.suppress(OSError):
                fcntl.flock(self._fd, fcntl.LOCK_UN)
        os.close(self._fd)
        self._fd = -1

    def _flush(self, queue: int) -> None:
        try:
            termios.tcflush(self._fd, queue)
        except (termios.error, ValueError) as error:
            raise self._gone(error) from None

    def _gone(self, error: Exception | None) -> WireDown:
        if self._fd < 0:
            return WireDown(f"{self.name}: the port is closed. Reconnect")
        why = error.args[-1] if error and error.args else "end of file"
        return WireDown(f"{self.name}: the port is gone ({why}). Check cable and power, then reconnect")


def open_serial(path: str, baud: int) -> SerialPort:
    """Open a device raw, 8N1, with an exclusive lock.

    Args:
        path: The path of the device.
        baud: Bits per second.

    Raises:
        WireDown: It cannot be opened, or another program has it.
    """
    try:
        device = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        RESERVE.lacked(error)
        if "lock" in str(error) or getattr(error, "errno", None) == errno.EBUSY:
            raise WireDown(in_use(path, users_of(path))) from None
        raise WireDown(f"{path}: cannot open at {baud} baud ({error}). Check port= and who else has it") from None
    try:
        fd = os.dup(device.fileno())  # The lock belongs to the open file, so the duplicate keeps it.
    finally:
        device.close()
    port = SerialPort(fd, path, owner=True)
    try:
        _wait_for_bytes(fd)
    except termios.error as error:
        port.close()
        raise WireDown(f"{path}: cannot be set up ({error.args[-1]}). Check port=") from None
    return port


def in_use(path: str, users: tuple[str, ...]) -> str:
    """Return the message for a port in use. ``users`` are the programs that could be found."""
    by = f" by {', '.join(users)}" if users else ""
    return f"{path}: in use{by}. End that first, or give another port="


def adopt_serial(fd: int, name: str = "serial port") -> SerialPort:
    """Adopt a descriptor that the opener of the device has already configured."""
    return SerialPort(fd, name, owner=False)


def _wait_for_bytes(fd: int) -> None:
    """Make a read block the task until a byte comes. With VMIN 0, which pyserial sets, "no data" and
    "unplugged" both read as b""."""
    os.set_blocking(fd, False)
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    attributes[6][termios.VTIME] = 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
