"""Encode and decode the registers of a Robotiq 2F gripper: commands, status, and what a status means.

Pure: values in and out of 16 bit registers, for any transport. The layout is from the instruction manual of the
2F-85, "Control" and "Modbus RTU communication". Facts that the manual leaves open are marked [assumed].
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence

import msgspec

OUTPUT = 0x03E8
INPUT = 0x07D0
REGISTERS = 3
"""Number of registers in each block. A host writes its command from register ``OUTPUT`` on (function 16), and reads
the status from register ``INPUT`` on (function 4)."""

TOP = 255
"""Largest value of position, speed and force. Position 0 is open and 255 closed. 255 is full speed or full
force."""

CURRENT_A = 0.01
"""Amperes per count of the current."""

ACTIVATION_S = 10.0
"""Longest time of an activation; 2 to 5 s are usual [assumed]."""

_ACTIVATE = 0x01
_GO_TO = 0x08
_RELEASE = 0x10


def counts_of(fraction: float) -> int:
    """Convert a fraction (0 to 1) to the value of a register (0 to 255)."""
    return round(TOP * fraction)


class Activation(enum.IntEnum):
    """State of the gripper's activation (status field gSTA)."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Contact(enum.IntEnum):
    """Result of the last motion of the fingers (status field gOBJ).

    Right after a new command, the status still has the result of the previous command. The result belongs to the
    new command only once the status also repeats (echoes) the position of the new command.
    """

    MOVING = 0
    OPENING = 1  # An object has stopped the fingers while they were opening.
    CLOSING = 2  # An object has stopped the fingers while they were closing.
    ARRIVED = 3  # The fingers are at the requested position. They met no object, or have lost it.


CONTACTS = {Contact.MOVING: math.nan, Contact.OPENING: -1.0, Contact.CLOSING: 1.0, Contact.ARRIVED: 0.0}
"""Values of the sensor ``contact``: met while opening, met while closing, no object. It is unknown while the
fingers move."""


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
"""This code is only information: the gripper keeps its grip, and the next request clears the code [assumed]."""
RELEASING = 0x0B
RELEASED = 0x0F

MAJOR = 0x0A
"""Faults with this number or a higher one can be cleared only by a new activation."""


def fault_words(fault: int) -> str:
    return f"{FAULTS.get(fault, 'unknown fault')} (gFLT {fault})"


class Command(msgspec.Struct, frozen=True):
    """A command to the gripper: the registers that a host writes. Position, speed and force are 0 to 255."""

    activate: bool = True  # rACT. Setting this bit starts the activation, which moves the fingers to both ends.
    go_to: bool = False  # rGTO. True: move to ``position``. False: the fingers stop where they are.
    position: int = 0
    speed: int = TOP
    force: int = TOP
    release: bool = False  # rATR. The automatic release: the fingers open slowly, and an object falls out.

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
    """The status of the gripper: the registers that a host reads. Some of them repeat (echo) the last command."""

    activated: bool = False  # gACT, which repeats the bit rACT of the last command.
    going: bool = False  # gGTO, which repeats the bit rGTO of the last command.
    activation: int = Activation.RESET
    contact: int = Contact.MOVING
    fault: int = NO_FAULT
    request: int = 0  # gPR, which repeats the position of the last command (rPR).
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
            registers[1] >> 8 & 0x0F,  # The upper four bits are the fault of a separate controller. Ignore them.
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
    """Return the command that stops the fingers of a gripper with this status, and keeps its grip.

    For a gripper that is not active, the command must not set rACT. Otherwise the gripper would begin its
    activation, which moves the fingers.
    """
    if not status.activated or status.activation == Activation.ACTIVATING:
        return RESET
    # Without the bit rGTO the position in a command moves nothing. Send a position that differs from the one that
    # the status repeats now. When the status repeats the new position, the gripper has received this command.
    offset = 1 if status.position < TOP else -1
    return Command(position=status.position + offset * (status.position == status.request))


def unsafe_words(status: Status, command: Command) -> str:
    """Return the reason why a gripper is not known to be safe, or an empty text if it is safe.

    Args:
        status: The status that was read after the command.
        command: The command that was written to stop the gripper.
    """
    if status.fault == RELEASING:
        return "automatic release is running: the fingers open"
    if status.activation == Activation.ACTIVATING:
        return "activating: the fingers move"
    if not command.activate:
        return "the gripper has not carried out the reset" if status.activated else ""
    if not status.activated:
        return "no longer activated"
    if status.going:
        return "the fingers still move to their target"
    if status.request != command.position:
        # A gripper that has not yet received the last setpoint also has rGTO 0. So only the repeated position shows
        # that it has received the hold.
        return f"the gripper has not confirmed the hold (sent {command.position}, it repeats {status.request})"
    return ""


def classify(command: Command, active: bool) -> str:
    """Return the kind of a command for the log of received messages (wire log): ``setpoint``, ``enable`` or
    ``safe``.

    ``active`` is True if the bit rACT was already set before this command.
    """
    if command.go_to or command.release:
        return "setpoint"
    return "enable" if command.activate and not active else "safe"
