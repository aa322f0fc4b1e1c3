"""Decide the next action of the standby process.

The standby is the last process that can stop a robot. It watches the root and the wire process, and acts only
when neither of them can. This module is a pure table: no I/O, no clock.

Invariant: at most one process can write to the robot. A silent process may be frozen and wake up later, so the
standby kills it (fences it) and waits for its end before it writes.

    root      wire      which process stops the robot
    runs      any       the root (it fences the wire and uses its own stop channel)
    silent    runs      the wire (it stops the robot by itself and exits)
    ended     runs      the wire, as above
    otherwise           the standby (it fences silent processes, then writes the safe state)
"""

from __future__ import annotations

import enum


class ProcessState(enum.StrEnum):
    """The state of a process, as the standby observes it from outside."""

    RUNS = "runs"  # its heartbeats come, or the process has just started
    SILENT = "silent"  # the process exists, but its heartbeat is overdue: it is frozen or in an endless loop
    ENDED = "ended"  # the process has exited, or was never started


class Action(enum.StrEnum):
    WAIT = "wait"
    FENCE = "fence"  # kill every silent process and wait for its end, then decide again
    MAKE_SAFE = "make safe"  # write the safe state to the robot
    LEAVE = "leave"  # exit, since nothing is left to do


_RUNS, _SILENT, _ENDED = ProcessState.RUNS, ProcessState.SILENT, ProcessState.ENDED

ACTIONS: dict[tuple[ProcessState, ProcessState, bool], Action] = {
    # The keys of this table are (state of the root, state of the wire, may be energised).
    (_RUNS, _RUNS, False): Action.WAIT,
    (_RUNS, _RUNS, True): Action.WAIT,
    # The root runs. It fences the wire and stops the robot.
    (_RUNS, _SILENT, False): Action.WAIT,
    (_RUNS, _SILENT, True): Action.WAIT,
    (_RUNS, _ENDED, False): Action.WAIT,
    (_RUNS, _ENDED, True): Action.WAIT,
    # The wire runs. It notices that the root is missing, stops the robot, and exits.
    (_SILENT, _RUNS, False): Action.WAIT,
    (_SILENT, _RUNS, True): Action.WAIT,
    (_ENDED, _RUNS, False): Action.WAIT,
    (_ENDED, _RUNS, True): Action.WAIT,
    # Neither works. A silent root may wake up later. While nothing is energised it can do no harm, so it is left
    # alive. The script that started it kills it before it starts the robot again.
    (_SILENT, _SILENT, False): Action.WAIT,
    (_SILENT, _SILENT, True): Action.FENCE,
    (_SILENT, _ENDED, False): Action.WAIT,
    (_SILENT, _ENDED, True): Action.FENCE,
    # Without a root, no process would kill a frozen wire process, and it would keep the robot's port open for ever.
    (_ENDED, _SILENT, False): Action.FENCE,
    (_ENDED, _SILENT, True): Action.FENCE,
    (_ENDED, _ENDED, False): Action.LEAVE,
    (_ENDED, _ENDED, True): Action.MAKE_SAFE,
}


def decide(root: ProcessState, wire: ProcessState, may_be_energised: bool) -> Action:
    """Return the standby's next action.

    Args:
        root: The root process as observed from outside.
        wire: The wire process as observed from outside.
        may_be_energised: True if any motor may still have torque (from ``page.SafetyPage``).

    Returns:
        ``FENCE`` before ``MAKE_SAFE`` if a process is silent and has not ended. ``LEAVE`` when nothing is energised
        and there is no process left to watch.
    """
    return ACTIONS[root, wire, may_be_energised]
