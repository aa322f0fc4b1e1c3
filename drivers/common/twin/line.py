"""The robot's end of a cable. The simulated robot reads from it and writes to it."""

from __future__ import annotations

import array
import contextlib
import fcntl
import os
import select
import shutil
import sys
import tempfile
import termios
import time
import tty
from typing import Protocol

import trio

CHUNK = 4096


class Channel(Protocol):
    """The robot's end of a connection with one client."""

    def bits_per_s(self) -> int | None:
        """Return the client's bit rate; None if the transfer of bytes takes no time."""
        ...

    async def receive(self) -> tuple[int, bytes]:
        """Wait for bytes. Return the time at which they were read (ns of CLOCK_MONOTONIC), and the bytes. Also wait
        while the cable is unplugged."""
        ...

    def send(self, data: bytes) -> None:
        """Send without waiting. Bytes that do not fit into the buffer are lost, as on a real line."""
        ...

    def quiet_for(self, seconds: float) -> bool:
        """Block this process for ``seconds`` and return True. If bytes arrive meanwhile, return False at once."""
        ...


class Line(Channel, Protocol):
    """A cable on which the robot has one client at a time."""

    @property
    def address(self) -> str:
        """Return the path or address to which a client connects. It stays the same after the cable was pulled and
        plugged in again."""
        ...

    def plug(self) -> None: ...

    def unplug(self) -> None: ...

    def close(self) -> None: ...


class PtyLine:
    """A simulated serial port: a pseudo-terminal with a symbolic link to it.

    Clients open the link. It disappears when the cable is pulled, and points to a new terminal when the cable is
    plugged in again. The /dev entries of USB adapters behave in the same way.
    """

    def __init__(self, link: str | None = None) -> None:
        """Prepare the port. The cable is not plugged in yet.

        Args:
            link: Path at which the port appears; by default in a temporary directory.

        Raises:
            FileExistsError: The path exists and is not a link.
        """
        if link and os.path.lexists(link) and not os.path.islink(link):
            raise FileExistsError(f"{link} exists and is not a link: choose another name for the port")
        self._directory = None if link else tempfile.mkdtemp(prefix="strands-twin-")
        self._link = link or os.path.join(self._directory or "", "port")
        self._master = -1
        self._slave = -1
        self._plugged = trio.Event()

    @property
    def address(self) -> str:
        return self._link

    def plug(self) -> None:
        if self._master >= 0:
            return
        # Keep the client's side open in this process, too. Otherwise, when a client closes it, a read here would
        # report an end of file.
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        new = f"{self._link}.{os.getpid()}.new"
        with contextlib.suppress(FileNotFoundError):
            os.unlink(new)
        os.symlink(os.ttyname(self._slave), new)
        os.replace(new, self._link)
        self._plugged.set()

    def unplug(self) -> None:
        if self._master < 0:
            return
        self._plugged = trio.Event()
        with contextlib.suppress(FileNotFoundError):
            # Remove the link first, because another process may soon get the same terminal.
            os.unlink(self._link)
        trio.lowlevel.notify_closing(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def close(self) -> None:
        self.unplug()
        if self._directory:
            shutil.rmtree(self._directory, ignore_errors=True)

    def bits_per_s(self) -> int | None:
        return None if self._slave < 0 else terminal_rate(self._slave)

    async def receive(self) -> tuple[int, bytes]:
        while True:
            await self.readable()
            if data := self.take():
                return time.monotonic_ns(), data

    async def readable(self) -> None:
        """Wait until there may be bytes to read. Also wait while the cable is unplugged."""
        while True:
            await self._plugged.wait()
            if self._master < 0:  # The cable was pulled again before this task ran.
                continue
            with contextlib.suppress(trio.ClosedResourceError):
                await trio.lowlevel.wait_readable(self._master)
                return

    def take(self) -> bytes:
        """Return the bytes that have arrived, without waiting."""
        with contextlib.suppress(BlockingIOError):
            if self._master >= 0:
                return os.read(self._master, CHUNK)
        return b""

    def quiet_for(self, seconds: float) -> bool:
        waiting, _, _ = select.select([self._master] if self._master >= 0 else [], [], [], seconds)
        return not waiting

    def send(self, data: bytes) -> None:
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)


_TCGETS2 = 0x802C542A
"""asm-generic/ioctls.h: struct termios2, 44 bytes; its last word is the output rate in bit/s.
Unlike tcgetattr it reports rates that have no B constant: 250 000, 128 000, 76 800."""


def terminal_rate(fd: int) -> int:
    """Return the bit rate that the client has set on this terminal."""
    if not sys.platform.startswith("linux"):
        return int(termios.tcgetattr(fd)[5])
    words = array.array("I", bytes(44))
    fcntl.ioctl(fd, _TCGETS2, words)
    return words[10]
