"""Checks that refuse commands to a Stretch in its reported state. Pure: no I/O. No value is ever limited
silently."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import Axis, AxisMode, finite
from strands_actors.contract.axis_gates import show, stale, unit_of
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.dynamixel.gates import FAULT_CODES
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S, parse_twist
from strands_actors.drivers.common.servo.gates import motor_fault, temperature, voltage
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import ARM, BASE, LIFT, StretchConfig
from .readings import CONTACT, UNHELD

ROUNDING = 1e-9
_STOPPED_ITSELF = {CONTACT: refusals.contact, UNHELD: refusals.safety_mode}
"""Word in ``faults`` of lift or arm: the refusal for it."""


# -- parsing


def parse(
    action: Mapping[str, object], robot: str, axes: Sequence[Axis], index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Parse an action into a target for all axes, followed by a mask of the axes that get a command.

    The mask contains the axes that the action names, and the joints of the previous target if it is still in
    force. A joint's goal stays in force as long as the sender keeps the right to command. A twist ends after
    ``LIFETIME_S``, and an action that names only joints lets it run until then. ``vy`` is accepted if it is
    zero, since this base cannot strafe.
    """
    plain: dict[str, object] = dict(action)
    if "vy" in plain:
        sideways = finite(plain.pop("vy"))
        if sideways is None:
            return refusals.vy_not_finite()
        if sideways != 0:
            return refusals.sideways(sideways)
        if not plain:
            plain = dict.fromkeys(BASE, 0.0)
    # The previous target without its mask.
    before = msgspec.structs.replace(state, target=state.target[: len(axes)])
    parsed = parse_twist(plain, robot, axes, index, before)
    if isinstance(parsed, Refused):
        return parsed
    base = [number for number, axis in enumerate(axes) if axis.mode is AxisMode.VELOCITY]
    drives = any(parsed.values[number] != 0 for number in base)
    named, until_ns = set(parsed.named), parsed.until_ns
    if drives:
        if not named.isdisjoint(base):
            until_ns = state.now_ns + round(LIFETIME_S * NS)
        named.update(base)
    if state.live is not None and len(state.target) > len(axes):
        # The wire may skip the older of two commands. The newer one therefore includes the joints of the older.
        named.update(_selected(state.target, len(axes)).difference(base))
    mask = float(sum(1 << axis_index for axis_index in named))
    return msgspec.structs.replace(parsed, values=(*parsed.values, mask), until_ns=until_ns)


def named_in(values: Sequence[float], axes: Sequence[str]) -> frozenset[str]:
    """Return the axes that the mask of a target selects."""
    return frozenset(axes[index] for index in _selected(values, len(axes)))


def _selected(values: Sequence[float], axes: int) -> set[int]:
    mask = int(values[axes])
    return {index for index in range(axes) if mask >> index & 1}


# -- conditions


def conditions() -> tuple[Condition, ...]:
    return Condition(_runstop, Reason.FAULT, always=True), Condition(_stopped_itself, Reason.FAULT, always=True)


def _runstop(observation: Observation, now_ns: int) -> Refused | None:
    sensors = observation.sensors
    if sensors.get("runstop", (0.0,)) == (0.0,):
        return None
    return refusals.runstop(runstop_cause(sensors))


def runstop_cause(sensors: Mapping[str, tuple[float, ...]]) -> str:
    """Return the sensor that shows why the robot has set its runstop by itself; empty if none does."""
    return next((sensor for sensor in refusals.RUNSTOP_CAUSES if sensors.get(sensor, (0.0,)) != (0.0,)), "")


def _stopped_itself(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse further motion after the board of the lift or the arm has stopped its motor by itself."""
    for joint in (LIFT, ARM):
        for word in observation.faults.get(joint, "").split(", "):
            if word in _STOPPED_ITSELF:
                return _STOPPED_ITSELF[word](joint, word)
    return None


# -- gates


def gates_of(config: StretchConfig, axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates (checks of a command) in the order in which they are applied. No gate checks a speed,
    because the motion profiles of boards and servos limit it."""
    return (
        _soft_limits(axes),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, FAULT_CODES),
        # This gate comes after the check of the servos' torque. Arming, which gives torque, also finds out whether
        # a servo was reset.
        _homed(axes),
        _wheel_speeds(config, axes),
        _wheel_watchdog(axes),
    )


def _sensor_value(state: GateState, name: str, index: int, default: float) -> float:
    values = state.observation.sensors.get(name, ())
    return values[index] if index < len(values) else default


def _soft_limits(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses a goal outside the present soft limits of a joint."""

    def soft_limits(candidate: Candidate, state: GateState) -> Refused | None:
        for index in candidate.named:
            axis, value = axes[index], candidate.values[index]
            if axis.mode is AxisMode.VELOCITY:
                continue
            low = _sensor_value(state, "limit_low", index, axis.low)
            high = _sensor_value(state, "limit_high", index, axis.high)
            if not low - ROUNDING <= value <= high + ROUNDING:
                bottom, top = show(low, axis.unit, inwards=math.ceil), show(high, axis.unit, inwards=math.floor)
                offered = show(value, axis.unit)
                return refusals.outside_soft_limits(axis.key, offered, unit_of(axis), f"{bottom}..{top}")
        return None

    return soft_limits


def _homed(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses to move a joint that is not homed and therefore does not know its position."""

    def homed(candidate: Candidate, state: GateState) -> Refused | None:
        for index in candidate.named:
            axis = axes[index]
            if axis.mode is AxisMode.POSITION and not _sensor_value(state, "homed", index, 0.0):
                return refusals.not_homed(axis.key)
        return None

    return homed


def _twist(candidate: Candidate, axes: Sequence[Axis]) -> tuple[float, float]:
    vx, wz = (candidate.values[index] for index, axis in enumerate(axes) if axis.mode is AxisMode.VELOCITY)
    return vx, wz


def _wheel_speeds(config: StretchConfig, axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses a twist at which a wheel would exceed its speed limit. Limiting the wheel's
    speed would change the direction of the motion."""
    most = config.parameters.wheel_m_s

    def wheel_speeds(candidate: Candidate, state: GateState) -> Refused | None:
        for side, speed in zip(("left", "right"), config.wheels(*_twist(candidate, axes)), strict=True):
            if not abs(speed) <= most + ROUNDING:
                return refusals.wheel_too_fast(side, speed, most, config.parameters.separation_m)
        return None

    return wheel_speeds


def _wheel_watchdog(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses to drive while the watchdog of the wheels is off."""

    def wheel_watchdog(candidate: Candidate, state: GateState) -> Refused | None:
        if not any(_twist(candidate, axes)) or state.observation.sensors.get("wheel_watchdog") == (1.0,):
            return None
        return refusals.wheel_watchdog_off()

    return wheel_watchdog
