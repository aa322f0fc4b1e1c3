"""Describe the actors of a process. If faults are allowed, also make the process fail on request, for tests."""

from __future__ import annotations

import os
import sys
import threading
import time

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.processes.reserve import RESERVE
from strands_actors.supervisors.root.messages import ActorInfo, Describe, Introspection

from . import refusals

ALLOW_FAULTS = "STRANDS_ACTORS_ALLOW_FAULTS"


class Break(Message, frozen=True):
    """Make this process fail, for tests and drills. ``how`` is ``exception``, ``exit``, ``spin`` (endless loop) or
    ``leak`` (take all file descriptors)."""

    lane = "urgent"

    how: str


class Broken(BaseException):
    """An exception that ends the process on request. Supervisors restart an actor after other exceptions, but not
    after this one."""


def fall(how: str) -> None:
    """Make this process fail.

    Args:
        how: ``exception``; ``exit``; ``spin``, which never returns; or ``leak``, which takes every free file
            descriptor until a stop begins. Any other value does nothing.
    """
    if how == "exception":
        raise RuntimeError("this fault was requested")
    if how == "exit":
        sys.exit(3)
    while how == "spin":
        pass
    if how == "leak":
        threading.Thread(target=_leak, daemon=True).start()


def _leak() -> None:
    while not RESERVE.is_freed:
        try:
            os.open(os.devnull, os.O_RDONLY)
        except OSError:
            time.sleep(0.001)


class Introspector(Actor):
    def receive(self, message: Describe | Break) -> Introspection | Refused | None:
        if isinstance(message, Break):
            return self._break(message.how)
        node, pid = self.context.node, os.getpid()
        return Introspection(
            pid,
            tuple(
                ActorInfo(cell.address, cell.role, pid, cell.state, max(0, cell.incarnations - 1))
                for cell in node.cells.values()
            ),
        )

    def _break(self, how: str) -> Refused | None:
        if os.environ.get(ALLOW_FAULTS) != "1":
            return refusals.faults_not_allowed(ALLOW_FAULTS)
        if how == "exception":
            raise Broken("this fault was requested")
        fall(how)
        return None if how == "leak" else refusals.unknown_fault(how)
