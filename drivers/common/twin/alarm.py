"""A timer whose time can be changed while a task waits for it.

On Linux it is a timerfd, which is 0.05 ms late and is set by one system call. On other systems it uses trio's
clock, which rounds to milliseconds.
"""

from __future__ import annotations

import ctypes
import math
import os
import struct
import sys
import time
from typing import Protocol

import trio

NS = 1_000_000_000
_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1


class Alarm(Protocol):
    def set(self, due_ns: int) -> None:
        """Set the time at which the timer expires, in ns of CLOCK_MONOTONIC. With a past time it expires at
        once."""
        ...

    async def ring(self) -> None:
        """Wait until the timer expires. It expires once for each ``set``, unless a later ``set`` has replaced the
        time."""
        ...

    def close(self) -> None: ...


class TimerfdAlarm:
    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._fd: int = self._libc.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")

    def set(self, due_ns: int) -> None:
        # The time 0 would switch the timer off.
        spec = struct.pack("qqqq", 0, 0, *divmod(max(due_ns, 1), NS))
        if self._libc.timerfd_settime(self._fd, _TIMER_ABSTIME, spec, None) != 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")

    async def ring(self) -> None:
        while True:
            await trio.lowlevel.wait_readable(self._fd)
            try:
                os.read(self._fd, 8)
                return
            # The timer was set again after this task had woken up and before it read. So wait again.
            except BlockingIOError:
                continue

    def close(self) -> None:
        os.close(self._fd)


class TrioAlarm:
    def __init__(self) -> None:
        self._due_s = math.inf
        self._moved = trio.Event()

    def set(self, due_ns: int) -> None:
        self._due_s = trio.current_time() + (due_ns - time.monotonic_ns()) / NS
        self._moved.set()

    async def ring(self) -> None:
        while trio.current_time() < self._due_s:
            self._moved = trio.Event()
            with trio.move_on_at(self._due_s):
                await self._moved.wait()
        self._due_s = math.inf
        await trio.lowlevel.checkpoint()

    def close(self) -> None:
        pass


def new_alarm() -> Alarm:
    return TimerfdAlarm() if sys.platform.startswith("linux") else TrioAlarm()
