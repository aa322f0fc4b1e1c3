"""A process of a robot that this process has not started. Notice its end, and kill it if necessary."""

from __future__ import annotations

import contextlib
import os
import select
import signal

import trio

from .process import NOTICED_S, wait_for_end_of


class Peer:
    """A process that is not a child of this process.

    Args:
        pid: Process id.
        pidfd: A descriptor that identifies the process, even after its id has been used again. None where the
            system has no pidfd (macOS). This object closes it.
    """

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
        """Return when the process has ended."""
        if self._pidfd is None:
            await wait_for_end_of(self.pid)
            return
        try:
            # Only one task may wait for a descriptor, so each task waits for a duplicate of it.
            fd = os.dup(self._pidfd)
        except OSError:
            # No descriptor is free, so check the process repeatedly.
            while not self.ended:  # noqa: ASYNC110  # there is no event to wait for
                await trio.sleep(NOTICED_S)
            return
        try:
            await trio.lowlevel.wait_readable(fd)
        finally:
            trio.lowlevel.notify_closing(fd)
            os.close(fd)

    async def fence(self, within_s: float) -> bool:
        """Kill the process and wait for its end. Return True if its end was seen.

        A killed process runs no more of its code, even before its end is seen.
        """
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
