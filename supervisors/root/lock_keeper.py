"""Keeps the lock of an e-stop on the disk while the robot is locked: in a thread, since a disk may
be slow.

It belongs to the root, which hears of every lock: of the wire, and of a fence that the wire does
not survive. The safe frames wait for nothing here; who reports that the robot is locked waits until
the lock is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import trio

from strands_actors.kernel.health.realtime import run_like_others

from .locks import Locks

KEEP_S = 1.0
"""A disk that takes longer is reported as one that keeps nothing."""
SLOW = f"the lock is not on the disk after {KEEP_S:g} s, and may end with this tree"


class Kept(NamedTuple):
    """``problem``: why the lock does not outlive the tree; empty: it does."""

    since: str
    problem: str = ""


class LockKeeper:
    """``found_by``: who had locked the robot before this tree; empty: nobody."""

    def __init__(self, locks: Locks) -> None:
        self._locks = locks
        found = locks.find()
        self.found_by = "" if found is None else found.by
        self._wanted = self.found_by
        self._done: str | None = self.found_by
        """What is on the disk; None while it is being written."""
        self._kept = Kept("" if found is None else found.since)
        self._changed = trio.Event()

    @property
    def since(self) -> str:
        """Of the lock that is on the disk."""
        return self._kept.since

    def want(self, by: str) -> None:
        """The robot is locked by them; empty: by nobody."""
        if by != self._wanted:
            self._wanted = by
            self._wake()

    async def kept(self, by: str) -> Kept:
        """Wait until that lock is kept, or cannot be, or another in its place; or until it is not
        wanted any more."""
        with trio.move_on_after(KEEP_S):
            while (self._wanted if by else "") != self._done:
                await self._changed.wait()
            return self._kept
        return Kept("", SLOW)

    async def settle(self) -> None:
        """Wait until nothing is left to do, for ``KEEP_S`` at most."""
        with trio.move_on_after(KEEP_S):
            while self._wanted != self._done:
                await self._changed.wait()

    async def run(self) -> None:
        """For ever."""
        while True:
            by = self._wanted
            if by == self._done:
                await self._changed.wait()
                continue
            self._done = None
            try:
                self._kept = Kept(await trio.to_thread.run_sync(self._write, by))
            except (OSError, RuntimeError) as error:  # the disk, or no thread can be started
                self._kept = Kept("", f"the lock ends with this tree: {error}")
            self._done = by
            self._wake()

    def _write(self, by: str) -> str:
        run_like_others()  # a root of legs runs before everything else; its disk need not
        if by:
            return self._locks.put(by)
        self._locks.lift()
        return ""

    def _wake(self) -> None:
        changed, self._changed = self._changed, trio.Event()
        changed.set()
