"""The hand of an arm: one more axis of its robot, ``gripper`` in percent open, with a speed and a force.

A target has two more numbers behind its axes: speed and force of the hand, in percent. They are ``UNNAMED`` as
long as no action has named the hand since the arm was armed or held. The hand then gets no command, so a motion of
the arm alone never moves the fingers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from strands_actors.contract.axis import Axis, parse_action
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import MotorReport, Observation, Permit
from strands_actors.kernel.messages import Refused

from . import refusals

AXIS = "gripper"
SPEED, FORCE = "gripper_speed", "gripper_force"
FULL = 100.0
"""Highest value of opening, speed and force, in percent."""

UNNAMED = -1.0
"""Speed and force in a target that does not command the hand."""

MODEL_UNITS = (FULL, -FULL)
"""Zero and scale of the axis: the simulated hand counts the fraction by which it is closed."""


class Hand(Protocol):
    """One connection to a hand, for the wire of its arm."""

    async def serve(self) -> None:
        """Read the hand until cancelled. Raise ``WireDown`` if its connection is lost."""

    def check_alive(self) -> None:
        """Raise ``WireDown`` if the hand has not answered for too long."""

    async def arm(self, permit: Permit, may_activate: bool) -> None:
        """Let the hand follow commands. Raise ``WireDown`` if that fails."""

    def write(self, target: tuple[float, ...]) -> None:
        """Send a target: opening, speed and force in percent. The permit was checked just before."""

    def begin_stop(self) -> int | None:
        """Send the stop at once. Return a number for ``confirm``; None if the connection is lost."""

    async def confirm(self, number: int | None) -> MotorReport:
        """Wait until the hand repeats the stop. Never raises."""
        ...

    @property
    def position(self) -> float:
        """The opening in percent."""
        ...

    @property
    def speed(self) -> float:
        """The measured speed in percent per second."""
        ...

    @property
    def stamp_ns(self) -> int:
        """The time of the position."""
        ...

    def sensors(self) -> dict[str, tuple[float, ...]]:
        """Return the other readings of the hand."""
        ...

    def fault(self) -> str:
        """Return the present fault in words. It is empty without a fault."""
        ...

    def close(self) -> None:
        """Close the connection, without writing anything."""


_BARE = GateState(0, Observation(0, (), ()), (), 0, stream=False)
"""An empty state for ``past_range``, which does not use it here."""


def hand_axis(number: int, speed: float = math.inf) -> Axis:
    """Return the axis of a hand.

    Args:
        number: The number of its motor in reports.
        speed: Its top speed in percent per second.
    """
    return Axis(key=AXIS, unit="percent", low=0.0, high=FULL, speed=speed, id=number)


class HandKeys:
    """Read the keys of an action for an arm with a hand, the last of the axes.

    Args:
        robot: The robot's name in refusals.
        axes: The axes of the arm, and then that of the hand.
        speed: Speed of an action without the key, 0 to 100 percent.
        force: Force of an action without the key, 0 to 100 percent.
    """

    def __init__(self, robot: str, axes: Sequence[Axis], speed: float = FULL, force: float = FULL) -> None:
        self._robot, self._axes = robot, axes
        self._index = {axis.key: index for index, axis in enumerate(axes)}
        self._unnamed = {SPEED: speed, FORCE: force}
        extras = [Axis(key=key, unit="percent", low=0.0, high=FULL) for key in self._unnamed]
        self._extras = {axis.key: index for index, axis in enumerate(extras)}
        self._extra_axes = extras
        self._in_range = past_range(extras, measured=False)

    def parse(self, action: Mapping[str, object], state: GateState) -> Candidate | Refused:
        """Return the target of every axis, and then speed and force of the hand."""
        count = len(self._axes)
        modifiers = {key: value for key, value in action.items() if key in self._extras}
        targets = {key: value for key, value in action.items() if key not in self._extras}
        if modifiers and {AXIS, f"{AXIS}.pos"}.isdisjoint(targets):
            return refusals.hand_not_named(", ".join(modifiers), AXIS)
        parsed = parse_action(targets, self._robot, self._axes, self._index, state.target[:count])
        if isinstance(parsed, Refused):
            return parsed
        values, named = parsed
        kept = state.target[count:] or (UNNAMED, UNNAMED)
        if self._index[AXIS] not in named:
            return Candidate((*values, *kept), named)
        extras = parse_action(
            {**self._unnamed, **modifiers}, self._robot, self._extra_axes, self._extras, (UNNAMED, UNNAMED)
        )
        if isinstance(extras, Refused):
            return extras
        refusal = self._in_range(Candidate(*extras), _BARE)
        return refusal or Candidate((*values, *extras[0]), named)


__all__ = ["AXIS", "FORCE", "FULL", "MODEL_UNITS", "SPEED", "UNNAMED", "Hand", "HandKeys", "hand_axis"]
