"""Another process of the tree that is no child of this one: its end is seen, and it can be
ended."""

from __future__ import annotations

import contextlib
import os
import select
import signal

import trio

from .process import NOTICED_S, wait_for_end_of


class Peer:
    """``pidfd``: names this very process, whoever has its number later; belongs to this object.
    None where the system has none (macOS)."""

    def __init__(self, pid: int, pidfd: int | None = None) -> None:
        self.pid = pid
        self._pidfd = pidfd

    @property
    def ended(self) -> bool:
        if self._pidfd is None:
            try:
                os.kill(self.pid, 0)
            except ProcessLookupError:
                return True
            return False
        poll = select.poll()
        poll.register(self._pidfd, select.POLLIN)
        return bool(poll.poll(0))

    async def wait(self) -> None:
        """Return when it has ended."""
        if self._pidfd is None:
            await wait_for_end_of(self.pid)
            return
        try:
            fd = os.dup(self._pidfd)  # one task each may wait for a descriptor
        except OSError:  # none is free
            while not self.ended:  # noqa: ASYNC110  # nothing tells of it
                await trio.sleep(NOTICED_S)
            return
        try:
            await trio.lowlevel.wait_readable(fd)
        finally:
            trio.lowlevel.notify_closing(fd)
            os.close(fd)

    async def fence(self, within_s: float) -> bool:
        """SIGKILL, then wait for its end; whether that was seen. What was killed runs no code of
        its own."""
        with contextlib.suppress(ProcessLookupError):
            if self._pidfd is None:
                os.kill(self.pid, signal.SIGKILL)
            else:
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
        with trio.move_on_after(within_s):
            while not self.ended:  # noqa: ASYNC110  # a descriptor may be gone, and it takes a moment only
                await trio.sleep(NOTICED_S / 10)
        return self.ended

    def close(self) -> None:
        if self._pidfd is not None:
            os.close(self._pidfd)
            self._pidfd = None
