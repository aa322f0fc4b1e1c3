"""What the standby does, by what it sees of root and wire. A table; no I/O, no clock.

As long as one of the two runs, that one makes the robot safe, and the standby waits. Nobody writes
before all who could write at the same time have ended: what is only silent is fenced first.
"""

from __future__ import annotations

import enum


class Seen(enum.StrEnum):
    """What a process looks like from outside."""

    RUNS = "runs"  # it beats, or begins
    SILENT = "silent"  # it is there, and has not beaten for too long: frozen, or it spins
    ENDED = "ended"  # it is gone, or there is none


class Action(enum.StrEnum):
    WAIT = "wait"
    FENCE = "fence"  # end what is silent, then look again
    MAKE_SAFE = "make safe"
    LEAVE = "leave"


_RUNS, _SILENT, _ENDED = Seen.RUNS, Seen.SILENT, Seen.ENDED

ACTIONS: dict[tuple[Seen, Seen, bool], Action] = {
    # (root, wire, whether something may be energised)
    (_RUNS, _RUNS, False): Action.WAIT,
    (_RUNS, _RUNS, True): Action.WAIT,
    # The root fences the wire and makes safe.
    (_RUNS, _SILENT, False): Action.WAIT,
    (_RUNS, _SILENT, True): Action.WAIT,
    (_RUNS, _ENDED, False): Action.WAIT,
    (_RUNS, _ENDED, True): Action.WAIT,
    # The wire makes safe by itself, and ends.
    (_SILENT, _RUNS, False): Action.WAIT,
    (_SILENT, _RUNS, True): Action.WAIT,
    (_ENDED, _RUNS, False): Action.WAIT,
    (_ENDED, _RUNS, True): Action.WAIT,
    # Nobody is left who acts. A root that is only silent may come back, and its caller ends it when
    # it wants another: as long as nothing is energised nobody needs to be ended.
    (_SILENT, _SILENT, False): Action.WAIT,
    (_SILENT, _SILENT, True): Action.FENCE,
    (_SILENT, _ENDED, False): Action.WAIT,
    (_SILENT, _ENDED, True): Action.FENCE,
    # A frozen wire without a root would keep the port for ever.
    (_ENDED, _SILENT, False): Action.FENCE,
    (_ENDED, _SILENT, True): Action.FENCE,
    (_ENDED, _ENDED, False): Action.LEAVE,
    (_ENDED, _ENDED, True): Action.MAKE_SAFE,
}


def decide(root: Seen, wire: Seen, owed: bool) -> Action:
    """Return what to do. ``owed``: something may be energised (``page.Owed``)."""
    return ACTIONS[root, wire, owed]
