"""Keep the lock of an e-stop on the disk while the robot is locked. A thread writes it, since a disk may be
slow.

The root does this, since it learns of every lock: of one in the wire, and of one in a fence that the wire does
not survive. Safe frames never wait for it. The report that the robot is locked waits until the lock is stored.
"""

from __future__ import annotations

from typing import NamedTuple

import trio

from strands_actors.kernel.health.realtime import run_like_others

from .locks import Locks

KEEP_S = 1.0
"""Seconds after which a slow disk is reported as one that stores nothing."""
SLOW = f"the lock is not on the disk after {KEEP_S:g} s, and may end with this tree"


class Kept(NamedTuple):
    """The state of the lock on the disk. ``problem`` is why it does not outlive the tree, or empty."""

    since: str
    problem: str = ""


class LockKeeper:
    """The keeper of one robot's lock.

    Attributes:
        found_by: The operator in a lock from before this tree. Empty if the robot was not locked.
    """

    def __init__(self, locks: Locks) -> None:
        self._locks = locks
        lock = locks.find()
        self.found_by = "" if lock is None else lock.by
        self._wanted = self.found_by
        self._done: str | None = self.found_by
        """The operator in the lock on the disk. None while it is being written."""
        self._kept = Kept("" if lock is None else lock.since)
        self._changed = trio.Event()

    @property
    def since(self) -> str:
        """The time of the lock on the disk."""
        return self._kept.since

    def want(self, by: str) -> None:
        """Note the operator of the lock. Empty if the robot is not locked."""
        if by != self._wanted:
            self._wanted = by
            self._wake()

    async def kept(self, by: str) -> Kept:
        """Wait until a lock is on the disk, or another in its place, until it cannot be stored, or until it is
        no longer needed."""
        with trio.move_on_after(KEEP_S):
            while (self._wanted if by else "") != self._done:
                await self._changed.wait()
            return self._kept
        return Kept("", SLOW)

    async def settle(self) -> None:
        """Wait until everything is written, for ``KEEP_S`` at most."""
        with trio.move_on_after(KEEP_S):
            while self._wanted != self._done:
                await self._changed.wait()

    async def run(self) -> None:
        """Write each change until cancelled."""
        while True:
            by = self._wanted
            if by == self._done:
                await self._changed.wait()
                continue
            self._done = None
            try:
                self._kept = Kept(await trio.to_thread.run_sync(self._write, by))
            except (OSError, RuntimeError) as error:  # an error of the disk, or no thread can be started
                self._kept = Kept("", f"the lock ends with this tree: {error}")
            self._done = by
            self._wake()

    def _write(self, by: str) -> str:
        # A root has real-time priority. This thread needs none.
        run_like_others()
        if by:
            return self._locks.put(by)
        self._locks.lift()
        return ""

    def _wake(self) -> None:
        changed, self._changed = self._changed, trio.Event()
        changed.set()
