"""Encode and decode the registers of a Robotiq 2F gripper: commands, status, and what a status means.

Pure: values in and out of 16 bit registers, for any transport. The layout is from the instruction manual of the
2F-85, "Control" and "Modbus RTU communication". Facts that the manual leaves open are marked [assumed].
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

import msgspec

OUTPUT = 0x03E8
INPUT = 0x07D0
REGISTERS = 3
"""Size of both blocks: host to gripper from ``OUTPUT`` (FC 16), gripper to host from ``INPUT`` (FC 04)."""

TOP = 255
"""Largest value. Position 0 is open and 255 closed; 255 is full speed and full force."""

CURRENT_A = 0.01
"""Amperes per count of the current."""

ACTIVATION_S = 10.0
"""Longest time of an activation; 2 to 5 s are usual [assumed]."""

_ACTIVATE = 0x01
_GO_TO = 0x08
_RELEASE = 0x10


def counts_of(fraction: float) -> int:
    """Return a fraction in counts of a register."""
    return round(TOP * fraction)


class Activation(enum.IntEnum):
    """State of the activation, gSTA."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Contact(enum.IntEnum):
    """Result of the motion, gOBJ.

    Right after a command it is still that of the previous command. It is valid only with the echo of the new one.
    """

    MOVING = 0
    OPENING = 1  # stopped by an object while opening
    CLOSING = 2  # stopped by an object while closing
    ARRIVED = 3  # at the requested position; no object was met, or it was lost


FAULTS = {
    0x00: "no fault",
    0x05: "action delayed, activation is not finished",
    0x07: "the activation bit is not set",
    0x08: "over temperature",
    0x09: "no communication for 1 s",
    0x0A: "under voltage",
    0x0B: "automatic release is running",
    0x0C: "internal fault",
    0x0D: "activation fault",
    0x0E: "over-current",
    0x0F: "automatic release is done",
}
NO_FAULT = 0x00
OVER_TEMPERATURE = 0x08
SILENCE = 0x09
"""A status only. The gripper keeps its grip, and the next request clears it [assumed]."""
RELEASING = 0x0B
RELEASED = 0x0F

MAJOR = 0x0A
"""From this fault on only a new activation helps."""


def fault_words(fault: int) -> str:
    return f"{FAULTS.get(fault, 'unknown fault')} (gFLT {fault})"


class Command(msgspec.Struct, frozen=True):
    """The output block, which a host writes."""

    activate: bool = True  # rACT; its rising edge moves the fingers through their whole stroke
    go_to: bool = False  # rGTO; without it the fingers stop where they are
    position: int = 0
    speed: int = TOP
    force: int = TOP
    release: bool = False  # rATR; opens the fingers slowly, and drops any object

    def registers(self) -> list[int]:
        action = self.activate * _ACTIVATE | self.go_to * _GO_TO | self.release * _RELEASE
        return [action << 8, self.position, self.speed << 8 | self.force]

    @classmethod
    def from_registers(cls, registers: Sequence[int]) -> Command:
        action, position, modifiers = registers[0] >> 8, registers[1] & 0xFF, registers[2]
        return cls(
            bool(action & _ACTIVATE),
            bool(action & _GO_TO),
            position,
            modifiers >> 8,
            modifiers & 0xFF,
            bool(action & _RELEASE),
        )


RESET = Command(activate=False, speed=0, force=0)
"""Clears a fault and ends an activation [assumed: the fingers stop]."""

ACTIVATE = Command(speed=0, force=0)


class Status(msgspec.Struct, frozen=True):
    """The input block, which a host reads."""

    activated: bool = False  # gACT, the echo of rACT
    going: bool = False  # gGTO, the echo of rGTO
    activation: int = Activation.RESET
    contact: int = Contact.MOVING
    fault: int = NO_FAULT
    request: int = 0  # gPR, the echo of rPR
    position: int = 0
    current: int = 0

    def registers(self) -> list[int]:
        state = self.activated * _ACTIVATE | self.going * _GO_TO | self.activation << 4 | self.contact << 6
        return [state << 8, self.fault << 8 | self.request, self.position << 8 | self.current]

    @classmethod
    def from_registers(cls, registers: Sequence[int]) -> Status:
        state = registers[0] >> 8
        return cls(
            bool(state & _ACTIVATE),
            bool(state & _GO_TO),
            state >> 4 & 0x03,
            state >> 6,
            registers[1] >> 8 & 0x0F,  # The high half belongs to the controller, not to the gripper.
            registers[1] & 0xFF,
            registers[2] >> 8,
            registers[2] & 0xFF,
        )

    @property
    def active(self) -> bool:
        return self.activation == Activation.ACTIVE

    @property
    def needs_activation(self) -> bool:
        return not self.active or self.fault >= MAJOR


def safe_command(status: Status) -> Command:
    """Return the command that stops a gripper in this state and keeps its grip.

    A gripper that is not active must not get rACT: it would begin its activation stroke.
    """
    if not status.activated or status.activation == Activation.ACTIVATING:
        return RESET
    # Without rGTO a position moves nothing. The command has another position than the gripper repeats now, so
    # that a later echo shows whether it was taken.
    offset = 1 if status.position < TOP else -1
    return Command(position=status.position + offset * (status.position == status.request))


def unsafe_words(status: Status, command: Command) -> str:
    """Return why a gripper is not known to be safe; empty if it is.

    Args:
        status: The status after the command.
        command: The safe command that was written.
    """
    if status.fault == RELEASING:
        return "automatic release is running: the fingers open"
    if status.activation == Activation.ACTIVATING:
        return "activating: the fingers move"
    if not command.activate:
        return "has not taken the reset up" if status.activated else ""
    if not status.activated:
        return "no longer activated"
    if status.going:
        return "still going to its position"
    if status.request != command.position:
        # rGTO may still be 0 from before a setpoint that is on its way. Only the echo of the position confirms.
        return f"has not taken the hold up: told {command.position}, it repeats {status.request}"
    return ""


def classify(command: Command, active: bool) -> str:
    """Return the kind of a write, in the terms of the wire log. ``active`` is true if rACT was set before."""
    if command.go_to or command.release:
        return "setpoint"
    return "enable" if command.activate and not active else "safe"
