"""The failsafe machine: states, events, epoch and actions as data. No I/O, no clock.

The gate steps this table, the property tests drive it, and the docs show it.

Theory. The machine has one question to answer: may a setpoint move the robot now?

* A setpoint is accepted only in ``WRITABLE`` modes. Every way into them starts with an ``ARM``, and an arming
  needs a ``RESUME``.
* An event without a row in a mode changes nothing there.
* ``raises`` means that the epoch rises. The wire refuses setpoints that were prepared in an older epoch. So
  every stop, hold, loss of the link and arming raises it.
* A late or lost writer (``HOLDING_REASONS``) is a HOLD if the driver's safe state for it keeps the motors
  energised. The next setpoint ends a hold.
* Everything else is a STOP, with any safe state. A gripper that keeps its grip is disarmed all the same, and
  only a resume lets it move again. An e-stop is a stop that also locks.
* A link that is lost while something may be energised leads to LOST. When the link is back, the safe state
  comes first.
* A tree that ends (``ENDING_REASONS``) stops for good: ENDING and ENDED have no row for a resume.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import msgspec

from strands_actors.contract.driver import Reason

ENDING_REASONS = frozenset({Reason.CALLER, Reason.CLEANUP, Reason.ROOT})
"""Reasons after which the processes of the tree end and accept no orders any more."""


class Mode(enum.StrEnum):
    DOWN = "down"  # no link; nothing is energised by this tree
    LOST = "lost"  # no link; it was lost while energised, or before the safe state was confirmed
    DISARMED = "disarmed"  # link up, on the safe state of a stop, waiting for a resume
    ARMING = "arming"  # being energised at the measured position
    ARMED = "armed"  # energised, setpoints are accepted
    HOLDING = "holding"  # energised at the measured position; the last writer is gone or late
    STOPPING = "stopping"  # safe frames are out, not yet confirmed
    UNCONFIRMED = "unconfirmed"  # a motor did not confirm the safe state
    FAILED = "failed"  # the restart budget is spent; only a new tree helps
    ENDING = "ending"  # the tree ends: safe frames are out, not yet confirmed; only a stop is accepted
    ENDED = "ended"  # the tree ends: the safe state is confirmed, or this tree had energised nothing


class Event(enum.StrEnum):
    LINK_UP = "link up"
    LINK_LOST = "link lost"
    RESUME = "resume"
    ARM_DONE = "arm done"
    ARM_FAILED = "arm failed"
    SETPOINT = "setpoint accepted"
    HOLD = "hold"  # a late or lost writer, on a safe state that keeps the motors energised
    STOP = "stop"  # any other reason, and any safe state that does not
    END = "end"  # the caller or the root has ended, or the tree is cleaned up
    SAFE_CONFIRMED = "safe confirmed"
    SAFE_UNCONFIRMED = "safe unconfirmed"
    GIVE_UP = "give up"


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
    (Mode.DOWN, Event.GIVE_UP): _FAILED,
    # A motor that was energised when the link was lost is still energised when it is back. So the safe state
    # comes first.
    (Mode.LOST, Event.LINK_UP): _STOP,
    (Mode.LOST, Event.STOP): Row(Mode.LOST, True, Action.MAKE_SAFE),
    # The state of the robot is unknown. A hold is tried, too, on every connection that can still be written.
    (Mode.LOST, Event.HOLD): Row(Mode.LOST, True, Action.MAKE_SAFE),
    (Mode.LOST, Event.END): _END,
    (Mode.LOST, Event.GIVE_UP): _FAILED,
    (Mode.DISARMED, Event.RESUME): Row(Mode.ARMING, True, Action.ARM),
    (Mode.DISARMED, Event.STOP): _STOP,
    (Mode.DISARMED, Event.LINK_LOST): Row(Mode.DOWN, True),
    (Mode.DISARMED, Event.END): _END,
    (Mode.DISARMED, Event.GIVE_UP): _FAILED,
    (Mode.ARMING, Event.ARM_DONE): Row(Mode.ARMED),
    (Mode.ARMING, Event.ARM_FAILED): _STOP,
    (Mode.ARMING, Event.STOP): _STOP,
    (Mode.ARMING, Event.LINK_LOST): _LOST,
    (Mode.ARMING, Event.END): _END,
    (Mode.ARMING, Event.GIVE_UP): _FAILED,
    (Mode.ARMED, Event.SETPOINT): Row(Mode.ARMED),
    (Mode.ARMED, Event.HOLD): Row(Mode.HOLDING, True, Action.MAKE_SAFE),
    (Mode.ARMED, Event.STOP): _STOP,
    (Mode.ARMED, Event.LINK_LOST): _LOST,
    (Mode.ARMED, Event.END): _END,
    (Mode.ARMED, Event.GIVE_UP): _FAILED,
    (Mode.HOLDING, Event.SETPOINT): Row(Mode.ARMED),
    (Mode.HOLDING, Event.STOP): _STOP,
    (Mode.HOLDING, Event.LINK_LOST): _LOST,
    (Mode.HOLDING, Event.END): _END,
    (Mode.HOLDING, Event.GIVE_UP): _FAILED,
    (Mode.STOPPING, Event.SAFE_CONFIRMED): Row(Mode.DISARMED),
    (Mode.STOPPING, Event.SAFE_UNCONFIRMED): Row(Mode.UNCONFIRMED),
    (Mode.STOPPING, Event.STOP): _STOP,
    (Mode.STOPPING, Event.LINK_LOST): _LOST,
    (Mode.STOPPING, Event.END): _END,
    (Mode.STOPPING, Event.GIVE_UP): _FAILED,
    # Arming reads every motor back, so one that is still wrong fails it and is stopped again.
    (Mode.UNCONFIRMED, Event.RESUME): Row(Mode.ARMING, True, Action.ARM),
    (Mode.UNCONFIRMED, Event.STOP): _STOP,
    (Mode.UNCONFIRMED, Event.LINK_LOST): _LOST,
    (Mode.UNCONFIRMED, Event.END): _END,
    (Mode.UNCONFIRMED, Event.GIVE_UP): _FAILED,
    (Mode.FAILED, Event.STOP): _FAILED,
    (Mode.FAILED, Event.END): _FAILED,
    (Mode.ENDING, Event.SAFE_CONFIRMED): Row(Mode.ENDED),
    (Mode.ENDING, Event.LINK_UP): _END,
    (Mode.ENDING, Event.STOP): _END,
    (Mode.ENDING, Event.END): _END,
    # A confirmed safe state stays confirmed, since nothing can be energised any more. So an END has no row
    # here.
    (Mode.ENDED, Event.LINK_UP): _ENDED,
    (Mode.ENDED, Event.STOP): _END,
}

WRITABLE = frozenset({Mode.ARMED, Mode.HOLDING})
SAFE = frozenset({Mode.DOWN, Mode.DISARMED, Mode.ENDED})
"""Modes in which nothing is energised by this tree. Only in these a stop is confirmed without a report."""
OVER = frozenset({Mode.ENDING, Mode.ENDED})
LINKED = frozenset(Mode) - {Mode.DOWN, Mode.LOST, Mode.FAILED} - OVER


class State(msgspec.Struct, frozen=True):
    """The state of the machine. ``locked_by`` is the operator of an e-stop. Only a resume clears it."""

    mode: Mode = Mode.DOWN
    epoch: int = 1
    locked_by: str = ""


def step(state: State, event: Event, locked_by: str = "") -> tuple[State, Action]:
    """Return the next state and the action.

    Args:
        state: The present state.
        event: The event.
        locked_by: With ``STOP``: the operator, which makes the stop an e-stop.
    """
    row = TRANSITIONS.get((state.mode, event))
    lock = locked_by or state.locked_by
    if row is None:
        return State(state.mode, state.epoch, lock), Action.NONE
    if event is Event.RESUME:
        lock = ""
    return State(row.mode, state.epoch + row.raises, lock), row.action
