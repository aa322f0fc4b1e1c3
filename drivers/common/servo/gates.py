"""What is refused before it reaches a bus of servos. Every gate is a pure function of the candidate
and the state; nothing is ever clipped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from strands_actors.contract.axis_gates import Axes, past_range, past_told_range, stale, too_fast
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.refusals import MotorCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

MAX_JUMP_DEG = 90.0
"""How far one command may send a joint, unless its user says otherwise. A servo goes there at its top
speed: a quarter of a turn takes a quarter of a second. What people send from hand to hand is less, and
a typo is often more (200 for 20). A gripper, in percent, has no such limit: it opens in one command."""
NO_MAX_JUMP_DEG = 360.0
"""More than any joint turns."""


def all_gates(
    axes: Axes,
    state_ttl_s: float,
    fault_codes: Mapping[str, MotorCode],
    max_jump_deg: float = MAX_JUMP_DEG,
) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they are asked: the first that refuses answers. A
    one-shot names where to go, not how fast: the servo's own top speed bounds it, and
    ``max_jump_deg`` how far. ``fault_codes``: as ``motor_fault`` takes them."""
    return (
        # The limits in a servo's own registers may be narrower than the range of its model: it would
        # stand still without a word, or stop on the way.
        past_told_range(axes, "travel_low", "travel_high", untold=past_range(axes)),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, fault_codes),
        too_fast(axes),
        jumps(axes, max_jump_deg),
    )


def jumps(axes: Axes, most_deg: float) -> GateCheck:
    """Refuse a command on its own that sends a joint further than ``most_deg`` from where it is. The
    commands of a stream are judged by their steps."""

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
    """Refuse to move a servo whose supply is outside its own limits."""

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
    """Refuse to move a servo that is as hot as its own limit."""

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
    """Refuse to move a motor that reports a fault, as words in ``faults``. ``codes``: word -> code
    of the refusal; the first word that has one decides, also what to do. Silence is not
    judged here: ``stale`` gives it time to come back."""

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
                said = f"is limp ({why})" if why else "is limp"
            else:
                said = f"reports {why}"
            return Refused(code, f"{axes[at].key} {said}", code.remedy, ", ".join(words), "no fault")
        return None

    return motor_fault


def _readings(candidate: Candidate, seen: Observation, *names: str) -> Iterator[tuple[int, list[float]]]:
    rows = [seen.sensors[name] for name in names if name in seen.sensors]
    if len(rows) == len(names):
        for at in candidate.named:
            yield at, [row[at] for row in rows]
