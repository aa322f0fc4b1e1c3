"""Refuse commands to a Stretch by the robot's own reports. Pure: no I/O. Nothing is ever clipped."""

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
from strands_actors.drivers.stretch.refusals import StretchCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .config import ARM, BASE, LIFT, StretchConfig
from .readings import CONTACT, UNHELD

ROUNDING = 1e-9
_HOMING = "run the homing routine on the robot: stretch_robot_home.py"
_STOPPED_ITSELF = {
    CONTACT: (
        StretchCode.CONTACT,
        "has met something, and was stopped by its board",
        "clear its way, then call resume()",
    ),
    UNHELD: (
        StretchCode.SAFETY_MODE,
        "is in its safety mode",
        "check its board and its supply, then call resume()",
    ),
}
"""Word in ``faults`` of lift or arm: refusal code, reason, and remedy."""


_SETS_RUNSTOP = (
    ("low_battery", "the battery is low", "charge it"),
    ("at_cliff", "the base has met a cliff", "move it away, switch the robot off and on"),
    ("tilted", "the robot is tilted", "set it upright"),
    ("high_current", "the robot has drawn too much current", "clear what it works against"),
)
"""Sensor: reason why the power board sets the runstop by itself, and first remedy. The board sets it again as long
as the reason lasts. It remembers a cliff until it is switched off."""


# -- parsing


def parse(
    action: Mapping[str, object], robot: str, axes: Sequence[Axis], index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Return the whole target, with a mask of the axes that get a command behind it.

    The mask has the axes that the action names, and the joints of the target in force. A joint's goal stays in
    force as long as the lease. A twist ends after ``LIFETIME_S``, and an action that names only joints lets it
    run until then. ``vy`` is accepted if it is zero, since this base cannot strafe.
    """
    plain: dict[str, object] = dict(action)
    if "vy" in plain:
        sideways = finite(plain.pop("vy"))
        if sideways is None:
            return Refused(Code.NOT_FINITE, "vy is no finite number", "leave it out")
        if sideways != 0:
            why = f"vy {sideways:g} m/s, and this base cannot strafe"
            return Refused(StretchCode.STRAFE, why, "turn with wz, drive with vx", f"{sideways:g}", "0")
        if not plain:
            plain = dict.fromkeys(BASE, 0.0)
    before = msgspec.structs.replace(state, target=state.target[: len(axes)])  # without its mask
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
        # The wire may get only the newer one of two commands, so that one includes the joints of the other.
        named.update(_told(state.target, len(axes)).difference(base))
    mask = float(sum(1 << at for at in named))
    return msgspec.structs.replace(parsed, values=(*parsed.values, mask), until_ns=until_ns)


def named_in(values: Sequence[float], axes: Sequence[str]) -> frozenset[str]:
    """Return the axes that get a command by a target's mask."""
    return frozenset(axes[at] for at in _told(values, len(axes)))


def _told(values: Sequence[float], axes: int) -> set[int]:
    mask = int(values[axes])
    return {at for at in range(axes) if mask >> at & 1}


# -- conditions


def conditions() -> tuple[Condition, ...]:
    return Condition(_runstop, Reason.FAULT, always=True), Condition(_went_on, Reason.FAULT, always=True)


def _runstop(observation: Observation, now_ns: int) -> Refused | None:
    sensors = observation.sensors
    if sensors.get("runstop", (0.0,)) == (0.0,):
        return None
    why, remedy = runstop_reason(sensors)
    return Refused(StretchCode.RUNSTOP, why, f"{remedy}, then resume()", "pressed")


def runstop_reason(sensors: Mapping[str, tuple[float, ...]]) -> tuple[str, str]:
    """Return why the runstop is on, as far as the robot reports it, and the remedy."""
    release = "release it on the robot"
    for sensor, why, first in _SETS_RUNSTOP:
        if sensors.get(sensor, (0.0,)) != (0.0,):
            return f"the robot sets its runstop: {why}", f"{first}, then {release}"
    return "the runstop is pressed", release


def _went_on(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse to move further while lift or arm was stopped by its own board."""
    for joint in (LIFT, ARM):
        for word in observation.faults.get(joint, "").split(", "):
            if word in _STOPPED_ITSELF:
                code, what, remedy = _STOPPED_ITSELF[word]
                return Refused(code, f"{joint} {what}", remedy, word, "none")
    return None


# -- gates


def gates_of(config: StretchConfig, axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they are checked. Speed is not checked here: the profiles of
    boards and servos limit it."""
    return (
        _soft_limits(axes),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, FAULT_CODES),
        _homed(axes),  # after the torque of servos, because arming finds out whether a servo was reset
        _wheel_speeds(config, axes),
        _wheel_watchdog(axes),
    )


def _row(state: GateState, name: str, at: int, default: float) -> float:
    row = state.observation.sensors.get(name, ())
    return row[at] if at < len(row) else default


def _soft_limits(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses a goal outside the present soft limits of its joint."""

    def soft_limits(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            axis, value = axes[at], candidate.values[at]
            if axis.mode is AxisMode.VELOCITY:
                continue
            low = _row(state, "limit_low", at, axis.low)
            high = _row(state, "limit_high", at, axis.high)
            if not low - ROUNDING <= value <= high + ROUNDING:
                bottom, top = show(low, axis.unit, inwards=math.ceil), show(high, axis.unit, inwards=math.floor)
                offered = show(value, axis.unit)
                return Refused(
                    StretchCode.SOFT_LIMIT,
                    f"{axis.key} {offered}{unit_of(axis)} is outside its soft limits of now",
                    f"stay within {bottom}..{top}",
                    offered,
                    f"{bottom}..{top}",
                )
        return None

    return soft_limits


def _homed(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses to move a joint that does not know its position."""

    def homed(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            axis = axes[at]
            if axis.mode is AxisMode.POSITION and not _row(state, "homed", at, 0.0):
                return Refused(StretchCode.NOT_HOMED, f"{axis.key} not homed", _HOMING, "not homed", "homed")
        return None

    return homed


def _twist(candidate: Candidate, axes: Sequence[Axis]) -> tuple[float, float]:
    vx, wz = (candidate.values[at] for at, axis in enumerate(axes) if axis.mode is AxisMode.VELOCITY)
    return vx, wz


def _wheel_speeds(config: StretchConfig, axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses a twist at which a wheel would exceed its speed limit. A clamped speed would
    change the twist."""
    most = config.parameters.wheel_m_s

    def wheel_speeds(candidate: Candidate, state: GateState) -> Refused | None:
        for side, speed in zip(("left", "right"), config.wheels(*_twist(candidate, axes)), strict=True):
            if not abs(speed) <= most + ROUNDING:
                return Refused(
                    StretchCode.WHEEL_SPEED,
                    f"the {side} wheel would run at {speed:.3f} m/s",
                    f"keep |vx| + |wz| * {config.parameters.separation_m / 2:.3f} within {most:g}",
                    f"{abs(speed):.3f}",
                    f"{most:g}",
                )
        return None

    return wheel_speeds


def _wheel_watchdog(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses to drive while the wheels have no watchdog."""

    def wheel_watchdog(candidate: Candidate, state: GateState) -> Refused | None:
        if not any(_twist(candidate, axes)) or state.observation.sensors.get("wheel_watchdog") == (1.0,):
            return None
        return Refused(
            StretchCode.NO_WATCHDOG,
            "the wheels' velocity watchdog is off",
            "set enable_vel_watchdog: 1 for both wheels in the robot's YAML, then connect again",
            "off",
            "on",
        )

    return wheel_watchdog
