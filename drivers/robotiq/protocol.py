"""The registers of a Robotiq 2F gripper: what is written to it, what it says, and what that means.

Pure: values in and out of 16 bit registers, whatever carries them. Layout: instruction manual of
the 2F-85, "Control" and "Modbus RTU communication". What the manual leaves open is marked
[assumed].
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

import msgspec

OUTPUT = 0x03E8
INPUT = 0x07D0
REGISTERS = 3
"""Both blocks: host to gripper from ``OUTPUT`` (FC 16), gripper to host from ``INPUT`` (FC 04)."""

TOP = 255
"""Position 0 is open, 255 closed; 255 is full speed and full force."""

CURRENT_A = 0.01
"""One count of the current."""

ACTIVATION_S = 10.0
"""Longest time an activation may take; 2 to 5 s are usual [assumed]."""

_ACTIVATE = 0x01
_GO_TO = 0x08
_RELEASE = 0x10


def counts_of(fraction: float) -> int:
    """Return a fraction as a register has it."""
    return round(TOP * fraction)


class Activation(enum.IntEnum):
    """gSTA."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Contact(enum.IntEnum):
    """gOBJ. Right after a command it still tells of the one before: believed only with its echo."""

    MOVING = 0
    OPENING = 1  # stopped by an object while opening
    CLOSING = 2
    ARRIVED = 3  # at the requested position; nothing was met, or it was lost


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
"""A status only: it keeps its grip, and the next question clears it [assumed]."""
RELEASING = 0x0B
RELEASED = 0x0F

MAJOR = 0x0A
"""From here on only a new activation helps."""


def fault_words(fault: int) -> str:
    return f"{FAULTS.get(fault, 'unknown fault')} (gFLT {fault})"


class Command(msgspec.Struct, frozen=True):
    """The output block."""

    activate: bool = True  # rACT. Its rising edge moves the fingers through their whole stroke
    go_to: bool = False  # rGTO; without it the fingers stop where they are
    position: int = 0
    speed: int = TOP
    force: int = TOP
    release: bool = False  # rATR: opens the fingers slowly, whatever they hold

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
    """The input block."""

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
            registers[1] >> 8 & 0x0F,  # the high half is the controller's, not the gripper's
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
    """Return what makes a gripper in this state keep still, and what it holds held. One that is not
    active must not be told to be: it would begin its activation stroke."""
    if not status.activated or status.activation == Activation.ACTIVATING:
        return RESET
    # Without rGTO a position moves nothing. It is one that the gripper does not repeat already, so
    # that its echo tells whether this command was taken up.
    beside = 1 if status.position < TOP else -1
    return Command(position=status.position + beside * (status.position == status.request))


def unsafe_words(status: Status, command: Command) -> str:
    """Say why a gripper that was given this safe command, and then said this, is not known to be
    safe; return nothing when it is."""
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
        # rGTO may be 0 from before a setpoint that is still on its way: only the echo tells.
        return f"has not taken the hold up: told {command.position}, it repeats {status.request}"
    return ""


def classify(command: Command, active: bool) -> str:
    """A write in the words of the wire log. ``active``: rACT was set before."""
    if command.go_to or command.release:
        return "setpoint"
    return "enable" if command.activate and not active else "safe"
