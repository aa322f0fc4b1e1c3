"""Simulate the twin's gripper: how its registers move the fingers, and how the fingers change the registers.

It is kinematic. A position controller moves the fingers at the requested speed until they meet a stop, an object
or their goal. On the wire no more than that can be seen.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

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
"""Counts of 10 mA while the fingers move, without an object [assumed]."""

LONGEST_STEP_S = 0.5
"""Longest time to catch up. After a longer pause of the process the gripper continues where it was."""

_TOO_EARLY = 0x05
_NOT_ACTIVATED = 0x07


class Setup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A gripper and its test bench."""

    stroke_mm: float
    speed_mm_s: tuple[float, float]
    open: int
    closed: int
    activation_s: float = 1.5
    object_mm: float = 0.0  # width of a rigid object between the fingers; 0 for no object
    echo_s: float = 0.0  # delay from a command's arrival until it takes effect
    activated: bool = False
    gflt: int = NO_FAULT  # the fault at the start; a minor one is permanent

    @classmethod
    def from_table(cls, table: Mapping[str, Any], **bench: Any) -> Setup:
        row = {name: table[name] for name in ("stroke_mm", "speed_mm_s", "open", "closed")}
        return msgspec.convert({**row, **bench}, cls)


class Gripper:
    """The gripper. Time passes between calls, on the given clock. It never waits."""

    def __init__(self, setup: Setup, now_s: Callable[[], float] = time.monotonic) -> None:
        self._setup = setup
        self._now_s = now_s
        self._then_s = now_s()
        self._born_s = self._heard_s = self._then_s
        self._position = float(setup.open)  # counts
        self.led_to: float | None = None
        """Goal of a simulation for the fingers, in counts, until a command moves them."""
        self._command = RESET
        self._coming: tuple[float, Command] | None = None
        self._activation = Activation.RESET
        self._activated_s = 0.0
        self._contact = Contact.ARRIVED
        self._fault = setup.gflt
        self._lasting_fault = setup.gflt if setup.gflt < MAJOR else NO_FAULT
        self._silence = False  # reported once after a silence
        self.stuck = False
        if setup.activated:
            self._command, self._activation = Command(position=setup.open), Activation.ACTIVE

    @property
    def asked_to_be_active(self) -> bool:
        """The last written rACT."""
        return (self._command if self._coming is None else self._coming[1]).activate

    @property
    def driven(self) -> bool:
        """Whether the fingers follow the registers: they have a goal, or an activation is running."""
        command = self._command if self._coming is None else self._coming[1]
        return command.activate and (command.go_to or self._activation != Activation.ACTIVE)

    def hear(self) -> None:
        """Note that a request has arrived."""
        now_s = self._now_s()
        self._silence = self._activation == Activation.ACTIVE and now_s - self._heard_s > SILENCE_S
        self._heard_s = now_s
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
            position=round(self._position),
            current=FREE_CURRENT if moving else self._command.force // 2 if pressed else 0,
        )

    @property
    def position(self) -> float:
        """The position in counts."""
        return self._position

    @property
    def time_s(self) -> float:
        """The time since the gripper was made."""
        return self._then_s - self._born_s

    def hurry(self, seconds: float) -> None:
        """Follow a simulation's goal for this time at once. The clock does not advance."""
        self._born_s -= seconds
        if self.led_to is not None and not (self.stuck or self.driven):
            self._lead(self.led_to, seconds)

    def open_up(self) -> None:
        """Open the fingers at once, and end a simulation's lead."""
        self._position, self.led_to = float(self._setup.open), None

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
            self.led_to = None
        if not before.activate:
            self._activation, self._activated_s = Activation.ACTIVATING, self._now_s()
            self._fault = self._lasting_fault
        if command.release:
            self._fault = RELEASING
        elif command.go_to and self._activation != Activation.ACTIVE:
            self._fault = _TOO_EARLY
        elif command.go_to and command != before:
            self._contact = Contact.MOVING  # Even for a short way: the first reading must show MOVING.

    def pass_time(self) -> None:
        now_s = self._now_s()
        step_s = min(now_s - self._then_s, LONGEST_STEP_S)
        self._then_s = now_s
        if self._coming is not None and self._coming[0] <= now_s:
            command, self._coming = self._coming[1], None
            self._obey(command)
        if self.stuck or step_s <= 0:
            return
        if self.led_to is not None and not self.driven:
            self._lead(self.led_to, step_s)
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
        """Move through the whole stroke and back."""
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
        if self._move(goal, speed_mm_s, step_s):
            met = self._object is not None and goal > self._object and self._position >= self._object
            self._contact = Contact.CLOSING if met else Contact.ARRIVED

    def _lead(self, goal: float, step_s: float) -> None:
        setup = self._setup
        self._move(min(max(goal, setup.open), setup.closed), setup.speed_mm_s[1], step_s)

    def _move(self, goal: float, speed_mm_s: float, step_s: float) -> bool:
        """Move towards ``goal`` as far as an object permits. Return whether the motion has ended."""
        if self._object is not None and self._position <= self._object:
            goal = min(goal, self._object)
        reach = speed_mm_s / self._setup.stroke_mm * TOP * step_s
        left = goal - self._position
        self._position += min(max(left, -reach), reach)
        return abs(left) <= reach

    @property
    def _object(self) -> float | None:
        """The position in counts at which the fingers touch the object; None without an object."""
        width_mm, stroke_mm = self._setup.object_mm, self._setup.stroke_mm
        return TOP * (1.0 - width_mm / stroke_mm) if width_mm > 0 else None
