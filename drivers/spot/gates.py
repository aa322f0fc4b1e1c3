"""Refuse commands to a Spot by the robot's own reports. Pure: no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import SHOWN, Axis, finite
from strands_actors.contract.axis_gates import past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.spot.refusals import SpotCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .protocol import TWIST_S, Motors, name_of
from .robots import ARM, BASE, CLAW, DRIVES, KEYS, LEGS, MOVES_ARM, MOVES_CLAW

LEASE, ESTOP, COMMAND, BEHAVIOUR = "lease", "estop", "command", "behaviour"
"""Keys of ``Observation.faults``."""


# -- conditions of the robot, independent of a command


def conditions_of() -> tuple[Condition, ...]:
    """Return the conditions in the order in which they are checked.

    A client that takes the lease controls the robot, so a lost lease leaves it standing for that client.
    """
    return (
        Condition(_lease, Reason.FAULT, SafeState.HOLD, on_resume=OnResume.ARM_ANEW),
        Condition(_estop_of_ours, Reason.FAULT, SafeState.SETTLE, always=True, on_resume=OnResume.ARM_ANEW),
        Condition(_estopped, Reason.FAULT, SafeState.SETTLE, always=True),
        Condition(_motors, Reason.FAULT, SafeState.HOLD, on_resume=OnResume.STAY_ARMED),
    )


def _lease(observation: Observation, now_ns: int) -> Refused | None:
    owner = observation.faults.get(LEASE)
    if owner is None:
        return None
    return Refused(SpotCode.LEASE_LOST, owner, "let its owner return it, then call resume()", owner)


def _estop_of_ours(observation: Observation, now_ns: int) -> Refused | None:
    why = observation.faults.get(ESTOP)
    if why is None:
        return None
    return Refused(SpotCode.ESTOP_LOST, why, "call resume(), which sets up the e-stop anew", why)


def _estopped(observation: Observation, now_ns: int) -> Refused | None:
    (pressed,) = observation.sensors.get("estopped", (0.0,))
    if not pressed:
        return None
    return Refused(SpotCode.ESTOPPED, "the robot is E-stopped", "release it first", "E-stopped")


def _motors(observation: Observation, now_ns: int) -> Refused | None:
    (motors,) = observation.sensors.get("motors", (float(Motors.UNKNOWN),))
    if motors == Motors.ON:
        return None
    state = name_of(Motors, int(motors))
    return Refused(Code.MOTORS_OFF, f"its motors are {state}", "call stand() first", state, "on")


# -- gates: checks of one command


def gates_of(axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    return _has_part, _whole_arm, _told(stale(axes, state_ttl_s)), past_range(axes), too_fast(axes, longest_s=0.1)


def _told(check: GateCheck) -> GateCheck:
    """Return a gate that checks only the values that the action names. All others count as 0."""

    def check_named(candidate: Candidate, state: GateState) -> Refused | None:
        values = tuple(
            value if index in candidate.named else 0.0 for index, value in enumerate(candidate.values[: len(KEYS)])
        )
        return check(Candidate(values, candidate.named), state)

    return check_named


def _whole_arm(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse to move an arm with a joint that has no target to keep, because it was missing in the reading
    with which the robot was armed. The six joints are commanded together."""
    if not candidate.values[MOVES_ARM]:
        return None
    unknown = [key for index, key in enumerate(KEYS) if key in ARM and math.isnan(candidate.values[index])]
    if not unknown:
        return None
    shown = ", ".join(unknown)
    return Refused(
        Code.STALE,
        f"no position from {shown} when the robot was armed, and the arm is told as a whole",
        f"name {shown} too, or call stop() and resume() once it is reported",
        shown,
        "all joints of the arm",
    )


def _has_part(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse joints of an arm that this robot lacks. ``stale`` would call them silent."""
    absent = [KEYS[at] for at in candidate.named if _is_absent(at, state.observation)]
    if not absent:
        return None
    what = "claw" if absent == [CLAW] else "arm"
    return Refused(
        SpotCode.NO_ARM, f"this robot has no {what}", f"use {', '.join(BASE)}", absent[0], ", ".join(BASE)
    )


def _is_absent(at: int, observation: Observation) -> bool:
    """Return True if the robot reports, but has never reported this joint."""
    return bool(observation.sensors) and math.isnan(observation.position[at]) and not observation.stamp_ns[at]


def refuse_leg(action: Mapping[str, object]) -> Refused | None:
    """Refuse to move a leg. Only the robot's own controller moves legs."""
    for key in action:
        if isinstance(key, str) and key.removesuffix(".pos") in LEGS:
            why = f"{key}: legs belong to the locomotion controller"
            return Refused(SpotCode.READ_ONLY, why, f"walk by {', '.join(BASE)}", key, ", ".join(KEYS))
    return None


def with_parts(candidate: Candidate, state: GateState) -> Candidate:
    """Return the target with its flags, which name the parts of the robot that get a command.

    A twist gets an end. The arm keeps its last target. A joint that was never read has no target, and
    none is invented, since a later command would send it.
    """
    named = {KEYS[at] for at in candidate.named}
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
            why = f"{axis.key} is {shown}"
            return Refused(Code.NOT_FINITE, why, "send a finite number", shown, "a finite number")
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
