"""Gates: pure functions that refuse a setpoint before it reaches the gripper. They never change (clip) a value."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from strands_actors.contract.axis import Axis, parse_action
from strands_actors.contract.axis_gates import past_range, stale
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import AXIS
from .protocol import NO_FAULT, SILENCE, Activation

POSITION, SPEED, FORCE = range(3)
"""Indices of the values in a target. Each value is a fraction: position 0 is open and 1 closed, speed 0 is slowest
and 1 fastest, force 0 is weakest and 1 strongest."""

_PLACES = 3
"""Number of axes by which a position can be given: first the closed fraction, then two openings in mm."""

_BARE = GateState(0, Observation(0, (), ()), (), 0, stream=False)
"""An empty state for ``past_range``, which does not use it here."""


class Keys:
    """The keys that an action may have: a position (closed fraction, or opening in mm), a speed and a force.

    Args:
        robot: The name of the robot in refusals.
        stroke_mm: The opening of the fully open gripper in mm.
        speed: The speed of an action that has no speed, 0 to 1.
        force: The force of an action that has no force, 0 to 1.
    """

    def __init__(self, robot: str, stroke_mm: float, speed: float = 1.0, force: float = 1.0) -> None:
        self._robot = robot
        self._unnamed = (math.nan,) * _PLACES + (speed, force)
        self._stroke_mm = stroke_mm
        self._axes = (
            _fraction(AXIS),
            Axis(key="position", unit="mm", low=0.0, high=stroke_mm),
            Axis(key="aperture_mm", unit="mm", low=0.0, high=stroke_mm),
            _fraction("speed"),
            _fraction("force"),
        )
        self._index = {axis.key: index for index, axis in enumerate(self._axes)}
        self._places = (AXIS, f"{AXIS}.pos", "position", "aperture_mm")
        self._names = (*self._places, "speed", "force")
        self._in_range = past_range(self._axes, measured=False)

    def places_in(self, action: Iterable[object]) -> list[str]:
        """Return the keys of an action that set the position of the fingers."""
        return [name for name in action if isinstance(name, str) and name in self._places]

    def parse(self, action: Mapping[str, object]) -> Candidate | Refused:
        """Return the target of an action: position, speed and force. Exactly one key must give the position."""
        for name in action:
            if not isinstance(name, str) or name not in self._names:
                shown = str(name)[:40] or "''"
                return refusals.unknown_key(shown, self._robot, ", ".join(self._names))
        named, places = self.places_in(action), ", ".join(self._places)
        if len(named) > 1:
            return refusals.several_positions(named, places)
        if not named:
            return refusals.no_position(", ".join(action) or "{}", places)
        parsed = parse_action(action, self._robot, self._axes, self._index, self._unnamed)
        if isinstance(parsed, Refused):
            return parsed
        requested = Candidate(*parsed)
        refusal = self._in_range(requested, _BARE)
        if refusal is not None:
            return refusal
        closed, *open_mm, speed, force = requested.values
        wide_mm = next((mm for mm in open_mm if not math.isnan(mm)), None)
        target = (closed if wide_mm is None else 1.0 - wide_mm / self._stroke_mm, speed, force)
        # The range check accepts values that are slightly out of range by rounding, so limit them here.
        return Candidate(tuple(min(1.0, max(0.0, value)) for value in target), (POSITION,))


def _fraction(key: str) -> Axis:
    return Axis(key=key, unit="", low=0.0, high=1.0)


def all_gates(axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they check a setpoint. The first refusal is reported."""
    return stale(axes, state_ttl_s), activated, fault_free


def activated(candidate: Candidate, state: GateState) -> Refused | None:
    activation = round(state.observation.sensors["activation"][0])
    if activation == Activation.ACTIVE:
        return None
    return refusals.not_activated(activation)


def fault_free(candidate: Candidate, state: GateState) -> Refused | None:
    fault = round(state.observation.sensors["fault"][0])
    return None if fault in (NO_FAULT, SILENCE) else refusals.fault(fault)


def mounted_gates(index: int) -> tuple[GateCheck, ...]:
    """Return the gates of a gripper on an arm.

    Args:
        index: Where the gripper is in the axes of the arm.
    """

    def gripper_follows(candidate: Candidate, state: GateState) -> Refused | None:
        sensors = state.observation.sensors
        if index not in candidate.named:
            return None
        activation, fault = round(sensors["gripper_activation"][0]), round(sensors["gripper_fault"][0])
        if activation != Activation.ACTIVE:
            return refusals.not_activated(activation)
        return None if fault in (NO_FAULT, SILENCE) else refusals.fault(fault)

    return (gripper_follows,)
