"""Keep the lock of an e-stop on the disk while the robot is locked. A thread writes it, since a disk may be slow.

The root does this, because it knows every lock: a lock that the gate in the wire process has set, and a lock of an
e-stop after which that process was killed. A stop never waits for the disk. The report that the robot is locked
waits until the lock is stored.
"""

from __future__ import annotations

from typing import NamedTuple

import trio

from strands_actors.kernel.health.realtime import run_like_others

from .locks import Locks

KEEP_S = 1.0
"""If the disk has not stored the lock after this many seconds, the report names this problem."""
SLOW = f"the lock is not on the disk after {KEEP_S:g} s, and may be lost when the robot's processes end"


class Kept(NamedTuple):
    """The state of the lock on the disk. ``since`` is its time. ``problem`` is why it will be lost when the robot's
    processes end; empty if it is stored."""

    since: str
    problem: str = ""


class LockKeeper:
    """Write the lock of one robot.

    Attributes:
        initial_operator: The operator in a lock that was on the disk at the start. Empty if the robot was not
            locked.
    """

    def __init__(self, locks: Locks) -> None:
        self._locks = locks
        lock = locks.find()
        self.initial_operator = "" if lock is None else lock.by
        self._requested = self.initial_operator
        self._done: str | None = self.initial_operator
        """The operator in the lock on the disk. None while it is being written."""
        self._kept = Kept("" if lock is None else lock.since)
        self._changed = trio.Event()

    @property
    def since(self) -> str:
        """Return when the lock on the disk was set; empty without a lock."""
        return self._kept.since

    def request(self, by: str) -> None:
        """Set the operator of the lock that must be on the disk. Empty means that there must be no lock."""
        if by != self._requested:
            self._requested = by
            self._wake()

    async def kept(self, by: str) -> Kept:
        """Wait until the lock is on the disk, or cannot be stored, or is no longer wanted. Return the state of the
        lock on the disk."""
        with trio.move_on_after(KEEP_S):
            while (self._requested if by else "") != self._done:
                await self._changed.wait()
            return self._kept
        return Kept("", SLOW)

    async def settle(self) -> None:
        """Wait until the last change is written, for ``KEEP_S`` at most."""
        with trio.move_on_after(KEEP_S):
            while self._requested != self._done:
                await self._changed.wait()

    async def run(self) -> None:
        """Write each change to the disk until cancelled."""
        while True:
            by = self._requested
            if by == self._done:
                await self._changed.wait()
                continue
            self._done = None
            try:
                self._kept = Kept(await trio.to_thread.run_sync(self._write, by))
            except (OSError, RuntimeError) as error:  # error of the disk, or no thread could be started
                self._kept = Kept("", f"the lock is lost when the robot's processes end: {error}")
            self._done = by
            self._wake()

    def _write(self, by: str) -> str:
        # The root process has real-time priority. This thread needs none.
        run_like_others()
        if by:
            return self._locks.put(by)
        self._locks.lift()
        return ""

    def _wake(self) -> None:
        changed, self._changed = self._changed, trio.Event()
        changed.set()
