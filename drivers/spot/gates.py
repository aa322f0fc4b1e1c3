"""Checks that refuse commands to a Spot in its reported state. Pure: no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import Axis, finite
from strands_actors.contract.axis_gates import past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume, Reason
from strands_actors.contract.refusals import not_finite
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .protocol import TWIST_S, Motors, name_of
from .robots import ARM, BASE, CLAW, DRIVES, KEYS, LEGS, MOVES_ARM, MOVES_CLAW

LEASE, ESTOP, COMMAND, BEHAVIOUR = "lease", "estop", "command", "behaviour"
"""Keys of ``Observation.faults``."""


# -- conditions that must be true of the robot, for any command


def conditions_of() -> tuple[Condition, ...]:
    """Return the conditions (checks that must pass while the robot is commanded), in the order in
    which they are checked.

    Another client that takes the lease (the right to command) controls the robot from then on. If
    the lease is lost, the robot is therefore left standing for that client.
    """
    return (
        Condition(_lease, Reason.FAULT, SafeState.HOLD, on_resume=OnResume.ARM_ANEW),
        Condition(_estop_of_ours, Reason.FAULT, SafeState.SETTLE, always=True, on_resume=OnResume.ARM_ANEW),
        Condition(_estopped, Reason.FAULT, SafeState.SETTLE, always=True),
        Condition(_motors, Reason.FAULT, SafeState.HOLD, on_resume=OnResume.STAY_ARMED),
    )


def _lease(observation: Observation, now_ns: int) -> Refused | None:
    loss = observation.faults.get(LEASE)
    return None if loss is None else refusals.lease_lost(loss)


def _estop_of_ours(observation: Observation, now_ns: int) -> Refused | None:
    loss = observation.faults.get(ESTOP)
    return None if loss is None else refusals.estop_lost(loss)


def _estopped(observation: Observation, now_ns: int) -> Refused | None:
    (pressed,) = observation.sensors.get("estopped", (0.0,))
    return refusals.estopped() if pressed else None


def _motors(observation: Observation, now_ns: int) -> Refused | None:
    (motors,) = observation.sensors.get("motors", (float(Motors.UNKNOWN),))
    if motors == Motors.ON:
        return None
    return refusals.motors_off(name_of(Motors, int(motors)))


# -- gates: each checks one command


def gates_of(axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    return (
        _has_part,
        _whole_arm,
        _only_named(stale(axes, state_ttl_s)),
        past_range(axes),
        too_fast(axes, longest_s=0.1),
    )


def _only_named(check: GateCheck) -> GateCheck:
    """Wrap a gate so that it checks only the values that the action names. All others count as 0."""

    def check_named(candidate: Candidate, state: GateState) -> Refused | None:
        values = tuple(
            value if index in candidate.named else 0.0 for index, value in enumerate(candidate.values[: len(KEYS)])
        )
        return check(Candidate(values, candidate.named), state)

    return check_named


def _whole_arm(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse to move the arm if one of its joints has no target. That joint reported no position
    when the robot was armed. The six joints are always commanded together."""
    if not candidate.values[MOVES_ARM]:
        return None
    unknown = [key for index, key in enumerate(KEYS) if key in ARM and math.isnan(candidate.values[index])]
    return refusals.incomplete_arm(unknown) if unknown else None


def _has_part(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse joints of an arm that this robot lacks. Without this check the gate ``stale`` would
    refuse them as joints that report nothing."""
    absent = [KEYS[index] for index in candidate.named if _is_absent(index, state.observation)]
    if not absent:
        return None
    part = "claw" if absent == [CLAW] else "arm"
    return refusals.no_part(part, absent[0], BASE)


def _is_absent(index: int, observation: Observation) -> bool:
    """Return True if the robot sends states, but no state has ever contained this joint."""
    return bool(observation.sensors) and math.isnan(observation.position[index]) and not observation.stamp_ns[index]


def refuse_leg(action: Mapping[str, object]) -> Refused | None:
    """Refuse to move a leg. Only the robot's own controller moves legs."""
    for key in action:
        if isinstance(key, str) and key.removesuffix(".pos") in LEGS:
            return refusals.read_only_leg(key, BASE, KEYS)
    return None


def with_parts(candidate: Candidate, state: GateState) -> Candidate:
    """Add the flags to a target. They name the parts of the robot that get a command.

    A twist gets an end time. The arm keeps its last target. A joint whose position was never read
    has no target, and no target is invented for it, because a later command would send it.
    """
    named = {KEYS[index] for index in candidate.named}
    speeds = candidate.values[: len(BASE)]
    drives = bool(named & set(BASE)) or any(speeds)
    until_ns = candidate.until_ns
    if any(speeds):
        ends_ns = state.now_ns + round(TWIST_S * NS)
        until_ns = min(until_ns, ends_ns) if until_ns else ends_ns
    flags = (float(drives), float(bool(named & set(ARM))), float(CLAW in named))
    return Candidate((*candidate.values, *flags), candidate.named, until_ns)


# -- services


def refuse_twist(arguments: Mapping[str, Any], axes: Sequence[Axis]) -> Refused | None:
    """Refuse a ``set_twist`` with a value that is no finite number or exceeds a limit."""
    speeds: list[float] = []
    for axis in axes[: len(BASE)]:
        value = finite(arguments.get(axis.key, 0.0))
        if value is None:
            shown = str(arguments.get(axis.key))[:SHOWN]
            return not_finite(axis.key, shown, shown)
        speeds.append(value)
    nothing = Observation(0, (0.0,) * len(BASE), (0,) * len(BASE))
    base = axes[: len(BASE)]
    candidate = Candidate(tuple(speeds), tuple(range(len(BASE))))
    return past_range(base)(candidate, GateState(0, nothing, tuple(speeds), 0, False))


__all__ = [
    "BEHAVIOUR",
    "COMMAND",
    "DRIVES",
    "ESTOP",
    "LEASE",
    "MOVES_ARM",
    "MOVES_CLAW",
    "conditions_of",
    "gates_of",
    "refuse_leg",
    "refuse_twist",
    "with_parts",
]
