"""The failsafe machine: states, events, epoch and actions as data. No I/O, no clock.

The gate looks up each event in this table, the property tests try all events, and the docs show the table.

Theory. The machine answers one question: may a setpoint move the robot now?

* A setpoint is accepted only in the ``WRITABLE`` modes, armed and holding. The only way into them is an ``ARM``,
  and only a ``RESUME`` leads to an ``ARM``.
* An event without a row for the present mode changes nothing.
* ``raises`` means that the epoch, a counter, is raised. The wire refuses setpoints that were made in an older
  epoch. So every stop, hold, lost link and arming raises it.
* A late or lost writer (``HOLDING_REASONS``) is a HOLD, if the driver's safe state for it keeps the motors
  energised. The next setpoint ends a hold.
* All other reasons are a STOP, with any safe state. Even a gripper that keeps its grip is disarmed, and moves again
  only after a resume. An e-stop is a stop that also locks the robot.
* If the link is lost while something may be energised, the mode is LOST. When the link is back, the safe state is
  written before anything else.
* When the robot's processes end (``ENDING_REASONS``), the stop is final: ENDING and ENDED have no row for a resume.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import msgspec

from strands_actors.contract.driver import Reason

ENDING_REASONS = frozenset({Reason.CALLER, Reason.CLEANUP, Reason.ROOT})
"""Reasons after which the processes of the tree end and accept no orders any more."""


class Mode(enum.StrEnum):
    DOWN = "down"  # not connected; the robot's processes have energised nothing
    LOST = "lost"  # not connected; the link was lost while energised, or before the safe state was confirmed
    DISARMED = "disarmed"  # connected and stopped, with a confirmed safe state; waits for a resume
    ARMING = "arming"  # the motors are being energised at the measured position
    ARMED = "armed"  # energised, setpoints are accepted
    HOLDING = "holding"  # energised at the measured position, because the last writer ended or is late
    STOPPING = "stopping"  # the safe state was written and is not yet confirmed
    UNCONFIRMED = "unconfirmed"  # a motor did not confirm the safe state
    FAILED = "failed"  # the wire process has failed too often; only a new start of the robot helps
    ENDING = "ending"  # the robot's processes end; the safe state is not yet confirmed; only a stop is accepted
    ENDED = "ended"  # the robot's processes end; the safe state is confirmed, or nothing had been energised


class Event(enum.StrEnum):
    LINK_UP = "link up"
    LINK_LOST = "link lost"
    RESUME = "resume"
    ARM_DONE = "arm done"
    ARM_FAILED = "arm failed"
    SETPOINT = "setpoint accepted"
    HOLD = "hold"  # a late or lost writer, on a safe state that keeps the motors energised
    STOP = "stop"  # any other reason, or a safe state that switches motors off
    END = "end"  # the script or the root process has ended, or the robot is cleaned up
    SAFE_CONFIRMED = "safe confirmed"
    SAFE_UNCONFIRMED = "safe unconfirmed"


class Action(enum.StrEnum):
    NONE = ""
    ARM = "arm"
    MAKE_SAFE = "make safe"


class Row(NamedTuple):
    mode: Mode
    raises: bool = False
    action: Action = Action.NONE


_STOP = Row(Mode.STOPPING, True, Action.MAKE_SAFE)
_LOST = Row(Mode.LOST, True)
_FAILED = Row(Mode.FAILED, True, Action.MAKE_SAFE)
_END = Row(Mode.ENDING, True, Action.MAKE_SAFE)
_ENDED = Row(Mode.ENDED, True, Action.MAKE_SAFE)

TRANSITIONS: dict[tuple[Mode, Event], Row] = {
    (Mode.DOWN, Event.LINK_UP): Row(Mode.DISARMED),
    (Mode.DOWN, Event.STOP): Row(Mode.DOWN, True, Action.MAKE_SAFE),
    (Mode.DOWN, Event.END): _ENDED,
    # A motor that was energised when the link was lost may still be energised when the link is back. So the safe
    # state is written first.
    (Mode.LOST, Event.LINK_UP): _STOP,
    (Mode.LOST, Event.STOP): Row(Mode.LOST, True, Action.MAKE_SAFE),
    # The state of the robot is unknown. The hold is tried on every connection on which bytes can still be sent.
    (Mode.LOST, Event.HOLD): Row(Mode.LOST, True, Action.MAKE_SAFE),
    (Mode.LOST, Event.END): _END,
    (Mode.DISARMED, Event.RESUME): Row(Mode.ARMING, True, Action.ARM),
    (Mode.DISARMED, Event.STOP): _STOP,
    (Mode.DISARMED, Event.LINK_LOST): Row(Mode.DOWN, True),
    (Mode.DISARMED, Event.END): _END,
    (Mode.ARMING, Event.ARM_DONE): Row(Mode.ARMED),
    (Mode.ARMING, Event.ARM_FAILED): _STOP,
    (Mode.ARMING, Event.STOP): _STOP,
    (Mode.ARMING, Event.LINK_LOST): _LOST,
    (Mode.ARMING, Event.END): _END,
    (Mode.ARMED, Event.SETPOINT): Row(Mode.ARMED),
    (Mode.ARMED, Event.HOLD): Row(Mode.HOLDING, True, Action.MAKE_SAFE),
    (Mode.ARMED, Event.STOP): _STOP,
    (Mode.ARMED, Event.LINK_LOST): _LOST,
    (Mode.ARMED, Event.END): _END,
    (Mode.HOLDING, Event.SETPOINT): Row(Mode.ARMED),
    (Mode.HOLDING, Event.STOP): _STOP,
    (Mode.HOLDING, Event.LINK_LOST): _LOST,
    (Mode.HOLDING, Event.END): _END,
    (Mode.STOPPING, Event.SAFE_CONFIRMED): Row(Mode.DISARMED),
    (Mode.STOPPING, Event.SAFE_UNCONFIRMED): Row(Mode.UNCONFIRMED),
    (Mode.STOPPING, Event.STOP): _STOP,
    (Mode.STOPPING, Event.LINK_LOST): _LOST,
    (Mode.STOPPING, Event.END): _END,
    # Arming reads every motor back. If a motor is still not safe, arming fails and the robot is stopped again.
    (Mode.UNCONFIRMED, Event.RESUME): Row(Mode.ARMING, True, Action.ARM),
    (Mode.UNCONFIRMED, Event.STOP): _STOP,
    (Mode.UNCONFIRMED, Event.LINK_LOST): _LOST,
    (Mode.UNCONFIRMED, Event.END): _END,
    (Mode.FAILED, Event.STOP): _FAILED,
    (Mode.FAILED, Event.END): _FAILED,
    (Mode.ENDING, Event.SAFE_CONFIRMED): Row(Mode.ENDED),
    (Mode.ENDING, Event.LINK_UP): _END,
    (Mode.ENDING, Event.STOP): _END,
    (Mode.ENDING, Event.END): _END,
    # In ENDED nothing can be energised any more, so a further END changes nothing and has no row.
    (Mode.ENDED, Event.LINK_UP): _ENDED,
    (Mode.ENDED, Event.STOP): _END,
}

WRITABLE = frozenset({Mode.ARMED, Mode.HOLDING})
SAFE = frozenset({Mode.DOWN, Mode.DISARMED, Mode.ENDED})
"""Modes in which nothing is energised by this tree. Only in these a stop is confirmed without a report."""
OVER = frozenset({Mode.ENDING, Mode.ENDED})
LINKED = frozenset(Mode) - {Mode.DOWN, Mode.LOST, Mode.FAILED} - OVER


class State(msgspec.Struct, frozen=True):
    """The state of the failsafe machine: its mode, and the epoch, a counter that each stop, hold, lost link and
    arming raises. ``locked_by`` is the operator of an e-stop; only a resume clears it."""

    mode: Mode = Mode.DOWN
    epoch: int = 1
    locked_by: str = ""


def step(state: State, event: Event, locked_by: str = "") -> tuple[State, Action]:
    """Return the next state of the failsafe machine, and the action: nothing, arm the robot, or make it safe.

    Args:
        state: The present state.
        event: The event.
        locked_by: Only for ``STOP``: the name of the operator. A stop with a name is an e-stop.
    """
    row = TRANSITIONS.get((state.mode, event))
    lock = locked_by or state.locked_by
    if row is None:
        return State(state.mode, state.epoch, lock), Action.NONE
    if event is Event.RESUME:
        lock = ""
    return State(row.mode, state.epoch + row.raises, lock), row.action
