"""Simulate a gripper: its registers move the fingers, and the fingers change the registers.

A position controller moves the fingers at the requested speed until they meet an end stop, an object or their goal.
A Modbus client cannot observe more than this of a real gripper. A gripper alone has no forces. On a simulated arm
the fingers follow this controller in the physics of the arm (``Fingers``).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec

from .protocol import (
    MAJOR,
    NO_FAULT,
    RELEASED,
    RELEASING,
    RESET,
    SILENCE,
    TOP,
    Activation,
    Command,
    Contact,
    Status,
)

SILENCE_S = 1.0
RELEASE_MM_S = 10.0
"""Speed of the automatic release [assumed]."""

FREE_CURRENT = 8
"""Current while the fingers move without an object, in counts of 10 mA [assumed]."""

LONGEST_STEP_S = 0.5
"""Longest pause of this process for which the simulation catches up. The rest of a longer pause is dropped."""

_TOO_EARLY = 0x05
_NOT_ACTIVATED = 0x07


class Setup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The properties of a simulated gripper, and the conditions of a test, such as an object in its fingers."""

    stroke_mm: float
    speed_mm_s: tuple[float, float]
    open: int
    closed: int
    activation_s: float = 1.5
    object_mm: float = 0.0  # Width of a rigid object between the fingers in mm. 0 for no object.
    echo_s: float = 0.0  # Delay in seconds from the arrival of a command until it takes effect.
    activated: bool = False
    gflt: int = NO_FAULT  # Number of the fault at the start. A minor fault (below ``MAJOR``) never ends.

    @classmethod
    def from_table(cls, table: Mapping[str, Any], **bench: Any) -> Setup:
        row = {name: table[name] for name in ("stroke_mm", "speed_mm_s", "open", "closed")}
        return msgspec.convert({**row, **bench}, cls)


class Fingers(Protocol):
    """Fingers with physics. Their positions are in register counts."""

    @property
    def position(self) -> float: ...

    @property
    def is_still(self) -> bool:
        """True if the fingers do not move."""
        ...

    def is_blocked(self, goal: float) -> bool:
        """Return True if something keeps the fingers from closing further, with the motor at ``goal``."""
        ...


class Gripper:
    """The simulated gripper. Each call first advances its fingers to the present time, which ``now_s`` returns.

    Args:
        setup: The properties of the gripper.
        now_s: Returns the present time in seconds.
        fingers: The fingers, if they have physics.
    """

    def __init__(
        self, setup: Setup, now_s: Callable[[], float] = time.monotonic, fingers: Fingers | None = None
    ) -> None:
        self._setup = setup
        self._fingers = fingers
        self._now_s = now_s
        self._then_s = now_s()
        self._born_s = self._last_request_s = self._then_s
        self._position = float(setup.open)  # Position of the motor in register counts.
        self.simulation_target: float | None = None
        """Goal of a simulation for the fingers, in counts, until a command moves them."""
        self._command = RESET
        self._coming: tuple[float, Command] | None = None
        self._activation = Activation.RESET
        self._activated_s = 0.0
        self._contact = Contact.ARRIVED
        self._fault = setup.gflt
        self._lasting_fault = setup.gflt if setup.gflt < MAJOR else NO_FAULT
        self._silence = False  # True if the next status must report a pause in the communication.
        self.stuck = False
        if setup.activated:
            self._command, self._activation = Command(position=setup.open), Activation.ACTIVE

    @property
    def activation_requested(self) -> bool:
        """The activation bit (rACT) of the last written command."""
        return (self._command if self._coming is None else self._coming[1]).activate

    @property
    def driven(self) -> bool:
        """True if commands of a client move the fingers: to a goal, or in an activation."""
        command = self._command if self._coming is None else self._coming[1]
        return command.activate and (command.go_to or self._activation != Activation.ACTIVE)

    def note_request(self) -> None:
        """Store the time of a client's request, to detect pauses in the communication."""
        now_s = self._now_s()
        self._silence = self._activation == Activation.ACTIVE and now_s - self._last_request_s > SILENCE_S
        self._last_request_s = now_s
        self.pass_time()

    def write(self, command: Command) -> None:
        if self._setup.echo_s:
            self._coming = self._now_s() + self._setup.echo_s, command
        else:
            self._obey(command)

    def status(self) -> Status:
        moving = self._contact == Contact.MOVING and self._command.go_to
        pressed = self._contact == Contact.CLOSING
        return Status(
            activated=self._command.activate,
            going=self._command.go_to,
            activation=self._activation,
            contact=self._contact if self._activation == Activation.ACTIVE else Contact.MOVING,
            fault=self._fault or (SILENCE if self._silence else NO_FAULT),
            request=self._command.position,
            position=round(self.position),
            current=FREE_CURRENT if moving else self._command.force // 2 if pressed else 0,
        )

    @property
    def position(self) -> float:
        """The position of the fingers in register counts (0 for open)."""
        return self._position if self._fingers is None else min(max(self._fingers.position, 0.0), float(TOP))

    @property
    def goal(self) -> float:
        """The position of the motor, to which it pulls fingers that have physics."""
        return self._position

    @property
    def time_s(self) -> float:
        """The simulated time in seconds, which begins at 0."""
        return self._then_s - self._born_s

    def advance_fast(self, seconds: float) -> None:
        """Move the fingers at once as far as a simulation's goal would move them in this time."""
        self._born_s -= seconds
        if self.simulation_target is not None and not (self.stuck or self.driven):
            self._move_towards(self.simulation_target, seconds)

    def open_up(self) -> None:
        """Open the fingers at once, and take them back from a simulation."""
        self._position, self.simulation_target = float(self._setup.open), None

    def power_cycle(self) -> None:
        """Reset the registers. The fingers stay where they are."""
        self._command, self._coming = RESET, None
        self._activation, self._contact = Activation.RESET, Contact.ARRIVED
        self._fault = self._lasting_fault

    def _obey(self, command: Command) -> None:
        before, self._command = self._command, command
        if not command.activate:
            self._activation = Activation.RESET
            self._fault = _NOT_ACTIVATED if command.go_to else self._lasting_fault
            return
        if command.go_to or not before.activate:
            self.simulation_target = None
        if not before.activate:
            self._activation, self._activated_s = Activation.ACTIVATING, self._now_s()
            self._fault = self._lasting_fault
        if command.release:
            self._fault = RELEASING
        elif command.go_to and self._activation != Activation.ACTIVE:
            self._fault = _TOO_EARLY
        elif command.go_to and command != before:
            self._contact = Contact.MOVING  # Even a short motion must show MOVING in the first status.

    def pass_time(self) -> None:
        now_s = self._now_s()
        step_s = min(now_s - self._then_s, LONGEST_STEP_S)
        self._then_s = now_s
        if self._coming is not None and self._coming[0] <= now_s:
            command, self._coming = self._coming[1], None
            self._obey(command)
        if self.stuck or step_s <= 0:
            return
        if self.simulation_target is not None and not self.driven:
            self._move_towards(self.simulation_target, step_s)
            return
        if self._activation == Activation.ACTIVATING:
            self._activate(step_s)
        elif self._fault == RELEASING:
            if self._move(self._setup.open, RELEASE_MM_S, step_s):
                self._fault = RELEASED
        elif self._activation == Activation.ACTIVE and self._command.go_to and not self._fault:
            slowest, fastest = self._setup.speed_mm_s
            self._go(slowest + (fastest - slowest) * self._command.speed / TOP, step_s)

    def _activate(self, step_s: float) -> None:
        """Continue an activation: the fingers close completely and open again."""
        setup = self._setup
        done = (self._now_s() - self._activated_s) / max(setup.activation_s, 1e-9)
        speed = 2.2 * setup.stroke_mm / max(setup.activation_s, 1e-9)
        self._move(setup.closed if done < 0.5 else setup.open, speed, step_s)
        if done >= 1.0:
            self._position = float(setup.open)
            self._activation, self._contact = Activation.ACTIVE, Contact.ARRIVED
            if self._fault == _TOO_EARLY:
                self._fault = self._lasting_fault

    def _go(self, speed_mm_s: float, step_s: float) -> None:
        setup = self._setup
        goal = min(max(self._command.position, setup.open), setup.closed)
        fingers = self._fingers
        if fingers is not None and goal >= self._position and fingers.is_blocked(self._position):
            self._contact = Contact.CLOSING
        elif self._move(goal, speed_mm_s, step_s) and (fingers is None or fingers.is_still):
            met = self._object is not None and goal > self._object and self._position >= self._object
            self._contact = Contact.CLOSING if met else Contact.ARRIVED

    def _move_towards(self, goal: float, step_s: float) -> None:
        setup = self._setup
        self._move(min(max(goal, setup.open), setup.closed), setup.speed_mm_s[1], step_s)

    def _move(self, goal: float, speed_mm_s: float, step_s: float) -> bool:
        """Move the fingers towards ``goal``, up to an object. Return True if this motion has ended."""
        if self._object is not None and self._position <= self._object:
            goal = min(goal, self._object)
        reach = speed_mm_s / self._setup.stroke_mm * TOP * step_s
        remaining = goal - self._position
        self._position += min(max(remaining, -reach), reach)
        return abs(remaining) <= reach

    @property
    def _object(self) -> float | None:
        """The position at which the fingers touch the object, in register counts. None without an object."""
        width_mm, stroke_mm = self._setup.object_mm, self._setup.stroke_mm
        return TOP * (1.0 - width_mm / stroke_mm) if width_mm > 0 else None
