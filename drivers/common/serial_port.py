"""A serial port as bytes: writes that are complete or fail, reads that wait under trio.

The port that opens the device owns it (an exclusive lock on the open file). A duplicate of its
descriptor, handed to another process, is adopted: same open file, same lock, same speed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
from typing import Protocol

import serial  # here: a root whose port was unplugged opens it anew, and a stop imports nothing
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

from .port_users import users_of

_READ_SIZE = 4096


class BytePort(Protocol):
    """What a bus needs of its port. Everything raises ``WireDown`` once the port is gone."""

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once, or raise: a frame that waits is a frame that leaves
        late."""
        ...

    async def read(self) -> bytes:
        """At least one byte, as soon as there is one."""
        ...

    def take(self) -> bytes:
        """Return what was received and not yet read, without waiting."""
        ...

    def discard_input(self) -> None:
        """Forget what was received and not yet read."""
        ...

    def discard_output(self) -> None:
        """Forget what was written and has not left yet. May cut a frame in two."""
        ...

    async def hung_up(self) -> None:
        """Return once the device is gone. Takes nothing of what it says."""
        ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class SerialPort:
    """A ``BytePort`` over the descriptor of an open terminal device. Closes it."""

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
            await trio.sleep_forever()  # where it cannot be told from data
        with select.epoll() as poll:
            try:
                poll.register(self._fd, 0)  # a hang-up is told unasked
            except PermissionError:
                await trio.sleep_forever()  # a plain file, as tests have: it never hangs up
            await trio.lowlevel.wait_readable(poll.fileno())

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        if self._fd < 0:
            return
        if self._owner:
            # a duplicate in another process would keep the lock, and us from opening the device
            # again
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
    """Open ``path`` raw, 8N1, locked against a second master. Raise ``WireDown``."""
    try:
        device = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        RESERVE.lacked(error)
        if "lock" in str(error) or getattr(error, "errno", None) == errno.EBUSY:
            raise WireDown(in_use(path, users_of(path))) from None
        raise WireDown(f"{path}: cannot open at {baud} baud ({error}). Check port= and who else has it") from None
    try:
        fd = os.dup(device.fileno())  # the lock belongs to the open file: it lives on in the duplicate
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
    """For people; ``users``: as far as they are known."""
    by = f" by {', '.join(users)}" if users else ""
    return f"{path}: in use{by}. End that first, or give another port="


def adopt_serial(fd: int, name: str = "serial port") -> SerialPort:
    """Take over an open descriptor, already configured by whoever opened the device."""
    return SerialPort(fd, name, owner=False)


def _wait_for_bytes(fd: int) -> None:
    """With VMIN 0, as pyserial leaves it, "no data" and "unplugged" both read as b""."""
    os.set_blocking(fd, False)
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    attributes[6][termios.VTIME] = 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
