"""Checks of commands to servos on a bus. Each check is a pure function of the command and the state, and never
clips a value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from strands_actors.contract.axis_gates import Axes, outside_reported_range, past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit import refusals
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.kernel.messages import Refused

MAX_JUMP_DEG = 90.0
"""Largest way of a joint by one command, unless the user sets another. A servo goes there at its top speed:
a quarter of a turn takes a quarter of a second. Commands by hand are usually smaller, and a typo is often
larger (200 for 20). A gripper, in percent, has no such limit: it opens by one command."""
NO_MAX_JUMP_DEG = 360.0
"""More than any joint turns."""


def all_gates(
    axes: Axes,
    state_ttl_s: float,
    fault_codes: Mapping[str, MotorCode],
    max_jump_deg: float = MAX_JUMP_DEG,
) -> tuple[GateCheck, ...]:
    """Return the checks of a command, in their order. If several checks refuse, the first refusal is reported.

    A single command (not part of a stream) has a target but no speed. The servo's top speed limits its speed,
    ``max_jump_deg`` its distance.

    Args:
        axes: The axes.
        state_ttl_s: Age in seconds beyond which a reading does not count.
        fault_codes: As for ``motor_fault``.
        max_jump_deg: Longest distance of a single command, in degrees.
    """
    return (
        # The limits in a servo's registers may be narrower than the range of its model. For a goal beyond its
        # limits, the servo would not move, or would stop at the limit, without an error.
        outside_reported_range(axes, "travel_low", "travel_high", fallback=past_range(axes)),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, fault_codes),
        too_fast(axes),
        jumps(axes, max_jump_deg),
    )


def jumps(axes: Axes, most_deg: float) -> GateCheck:
    """Refuse a single command with a target that is more than ``most_deg`` from the joint's position. Commands of a
    stream are not checked here, because ``too_fast`` limits their steps."""

    def jumps(candidate: Candidate, state: GateState) -> Refused | None:
        if state.stream:
            return None
        for index in candidate.named:
            distance = abs(candidate.values[index] - state.observation.position[index])
            if axes[index].unit == "deg" and not distance <= most_deg:
                return refusals.jump(axes[index].key, distance, candidate.values[index], most_deg)
        return None

    return jumps


def voltage(axes: Axes) -> GateCheck:
    """Refuse to move a servo if its supply voltage is outside its limits."""

    def voltage(candidate: Candidate, state: GateState) -> Refused | None:
        for index, (volt, low, high) in _readings(
            candidate, state.observation, "voltage_v", "voltage_min_v", "voltage_max_v"
        ):
            if volt < low or volt > high:
                return refusals.voltage_out_of_range(axes[index].label, volt, low, high)
        return None

    return voltage


def temperature(axes: Axes) -> GateCheck:
    """Refuse to move a servo if its temperature has reached its limit."""

    def temperature(candidate: Candidate, state: GateState) -> Refused | None:
        for index, (celsius, high) in _readings(candidate, state.observation, "temperature_c", "temperature_max_c"):
            if celsius >= high:
                return refusals.too_hot(axes[index].label, celsius, high)
        return None

    return temperature


def motor_fault(axes: Axes, codes: Mapping[str, MotorCode]) -> GateCheck:
    """Refuse to move a motor that reports a fault.

    A silent motor is not refused here. The check ``stale`` refuses it later, so that the motor has time to answer
    again.

    Args:
        axes: The axes.
        codes: The refusal code of each fault name in ``Observation.faults``. The first fault with a code decides.
    """

    def motor_fault(candidate: Candidate, state: GateState) -> Refused | None:
        faults = state.observation.faults
        if not faults:
            return None
        for index in candidate.named:
            words = faults.get(axes[index].key, "").split(", ")
            words = [word for word in words if word and word != "silent"]
            if not words:
                continue
            code = next((codes[word] for word in words if word in codes), MotorCode.FAULT)
            return refusals.motor_fault(code, axes[index].key, words)
        return None

    return motor_fault


def _readings(candidate: Candidate, observation: Observation, *names: str) -> Iterator[tuple[int, list[float]]]:
    rows = [observation.sensors[name] for name in names if name in observation.sensors]
    if len(rows) == len(names):
        for index in candidate.named:
            yield index, [row[index] for row in rows]
