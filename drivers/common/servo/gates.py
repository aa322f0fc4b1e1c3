"""Gates of servo buses. Every gate is a pure function of the candidate and the state, and never clips a
value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from strands_actors.contract.axis_gates import Axes, outside_reported_range, past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

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
    """Return the gates in the order of the checks. The first that refuses gives the answer.

    A single command has a target but no speed. The servo's top speed bounds its speed, and
    ``max_jump_deg`` its way.

    Args:
        axes: The axes.
        state_ttl_s: Oldest reading that counts, in seconds.
        fault_codes: As for ``motor_fault``.
        max_jump_deg: Longest way of a single command, in degrees.
    """
    return (
        # The limits in the registers of a servo may be narrower than the range of its model. Beyond them
        # the servo would stand still without an error, or stop on the way.
        outside_reported_range(axes, "travel_low", "travel_high", untold=past_range(axes)),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, fault_codes),
        too_fast(axes),
        jumps(axes, max_jump_deg),
    )


def jumps(axes: Axes, most_deg: float) -> GateCheck:
    """Refuse a single command that sends a joint further than ``most_deg`` from its position. The commands of a
    stream are checked by their steps."""

    def jumps(candidate: Candidate, state: GateState) -> Refused | None:
        if state.stream:
            return None
        for at in candidate.named:
            way = abs(candidate.values[at] - state.observation.position[at])
            if axes[at].unit == "deg" and not way <= most_deg:
                key, limit = axes[at].key, f"{most_deg:g}"
                why = f"{key} would go {way:.1f} deg at full speed, limit {limit} deg"
                there = f'move_to({{"{key}": {candidate.values[at]:.4g}}}, seconds=2)'
                remedy = f"use {there}, or make the robot with a larger max_jump"
                return Refused(Code.JUMP, why, remedy, f"{way:.1f}", limit)
        return None

    return jumps


def voltage(axes: Axes) -> GateCheck:
    """Refuse to move a servo with a supply outside the servo's limits."""

    def voltage(candidate: Candidate, state: GateState) -> Refused | None:
        for at, (volt, low, high) in _readings(
            candidate, state.observation, "voltage_v", "voltage_min_v", "voltage_max_v"
        ):
            if volt < low or volt > high:
                return Refused(
                    MotorCode.VOLTAGE,
                    f"{axes[at].label} has {volt:.1f} V",
                    f"supply {low:.1f}..{high:.1f} V",
                    offered=f"{volt:.1f}",
                    limit=f"{low:.1f}..{high:.1f}",
                )
        return None

    return voltage


def temperature(axes: Axes) -> GateCheck:
    """Refuse to move a servo at or above the servo's limit of temperature."""

    def temperature(candidate: Candidate, state: GateState) -> Refused | None:
        for at, (celsius, high) in _readings(candidate, state.observation, "temperature_c", "temperature_max_c"):
            if celsius >= high:
                return Refused(
                    MotorCode.TEMPERATURE,
                    f"{axes[at].label} is at {celsius:.0f} deg C",
                    f"let it cool below {high:.0f} deg C",
                    offered=f"{celsius:.0f}",
                    limit=f"{high:.0f}",
                )
        return None

    return temperature


def motor_fault(axes: Axes, codes: Mapping[str, MotorCode]) -> GateCheck:
    """Refuse to move a motor that reports a fault.

    Silence is not checked here, because ``stale`` gives a motor time to come back.

    Args:
        axes: The axes.
        codes: The code of the refusal, by word in ``Observation.faults``. The first word with a code
            decides, and its code has the remedy.
    """

    def motor_fault(candidate: Candidate, state: GateState) -> Refused | None:
        faults = state.observation.faults
        if not faults:
            return None
        for at in candidate.named:
            words = faults.get(axes[at].key, "").split(", ")
            words = [word for word in words if word and word != "silent"]
            if not words:
                continue
            code = next((codes[word] for word in words if word in codes), MotorCode.FAULT)
            why = ", ".join(word for word in words if word != "limp")
            if code == MotorCode.LIMP or "limp" in words:
                state_text = f"is limp ({why})" if why else "is limp"
            else:
                state_text = f"reports {why}"
            return Refused(code, f"{axes[at].key} {state_text}", code.remedy, ", ".join(words), "no fault")
        return None

    return motor_fault


def _readings(candidate: Candidate, seen: Observation, *names: str) -> Iterator[tuple[int, list[float]]]:
    rows = [seen.sensors[name] for name in names if name in seen.sensors]
    if len(rows) == len(names):
        for at in candidate.named:
            yield at, [row[at] for row in rows]
