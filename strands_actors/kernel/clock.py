"""Time: nanoseconds of one monotonic clock, everywhere.

Between processes of one host a deadline is a CLOCK_MONOTONIC reading, so it means the same in each of them.
Under ``trio.testing.MockClock`` the same code reads trio's clock, and all processes of a robot run in virtual
time.

A periodic task ticks on a timerfd. trio passes epoll a timeout rounded to milliseconds, which is 0.6 ms late on
average. A timerfd is 0.05 ms late, like a C loop. Where there is no timerfd (macOS, virtual time), trio's own
clock is used, which is less exact.
"""

from __future__ import annotations

import ctypes
import math
import os
import struct
import sys
import time
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Protocol

import trio

NS = 1_000_000_000


class Clock(Protocol):
    """The clock that every actor uses."""

    def now_ns(self) -> int:
        """Return nanoseconds of the host's monotonic clock."""
        ...

    async def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at ``deadline_ns`` or just after."""
        ...

    def ticks(self, period_s: float) -> AsyncGenerator[int, None]:
        """Yield ``now_ns`` once per period.

        A missed tick is skipped, and does not follow later. A caller that leaves the loop without being
        cancelled must close the generator (``contextlib.aclosing``).
        """
        ...


class VirtualClock:
    """The clock of robots that run under ``MockClock`` in tests. It reads trio's clock."""

    def now_ns(self) -> int:
        return round(trio.current_time() * NS)

    async def sleep_until_ns(self, deadline_ns: int) -> None:
        await trio.sleep_until(deadline_ns / NS)

    async def ticks(self, period_s: float) -> AsyncGenerator[int, None]:
        start = trio.current_time()
        index = 0
        while True:
            index = max(index + 1, math.floor((trio.current_time() - start) / period_s))
            await trio.sleep_until(start + index * period_s)
            yield self.now_ns()


class MonotonicClock:
    """CLOCK_MONOTONIC, with timerfd ticks where the system has them."""

    now_ns = staticmethod(time.monotonic_ns)

    async def sleep_until_ns(self, deadline_ns: int) -> None:
        await trio.sleep(max(0.0, (deadline_ns - time.monotonic_ns()) / NS))

    async def ticks(self, period_s: float) -> AsyncGenerator[int, None]:
        fd = _timerfd(period_s)
        if fd is None:
            async with aclosing(VirtualClock().ticks(period_s)) as ticks:
                async for _ in ticks:
                    yield time.monotonic_ns()
            return
        try:
            while True:
                await trio.lowlevel.wait_readable(fd)
                os.read(fd, 8)
                yield time.monotonic_ns()
        finally:
            trio.lowlevel.notify_closing(fd)
            os.close(fd)


_CLOCK_MONOTONIC = 1
_TFD_NONBLOCK = getattr(os, "O_NONBLOCK", 0)
_TFD_CLOEXEC = getattr(os, "O_CLOEXEC", 0)


def _timerfd(period_s: float) -> int | None:
    """Return a periodic timerfd, or None where the system has none.

    It uses ctypes because the os module has timerfd only from Python 3.13 on.
    """
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None, use_errno=True)
    fd: int = libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_NONBLOCK | _TFD_CLOEXEC)
    if fd < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create")
    whole, part = divmod(round(period_s * NS), NS)
    spec = struct.pack("qqqq", whole, part, whole, part)
    if libc.timerfd_settime(fd, 0, spec, None) != 0:
        error = ctypes.get_errno()
        os.close(fd)
        raise OSError(error, "timerfd_settime")
    return fd


def has_timerfd() -> bool:
    """Return True if periodic tasks tick on a timerfd on this system."""
    fd = _timerfd(1.0)
    if fd is not None:
        os.close(fd)
    return fd is not None
