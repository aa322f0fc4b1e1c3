"""What a Spot refuses, from what it reports. Pure."""

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


# -- conditions: what must be true of it, whatever it is told


def conditions_of() -> tuple[Condition, ...]:
    """Return them in the order in which they are asked. Whoever takes the lease has the robot: it
    is left standing for him."""
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


# -- gates: of one command


def gates_of(axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    return _has_part, _whole_arm, _told(stale(axes, state_ttl_s)), past_range(axes), too_fast(axes, longest_s=0.1)


def _told(check: GateCheck) -> GateCheck:
    """Return a gate that looks at what the robot is told, and at no part that it is not."""

    def told(candidate: Candidate, state: GateState) -> Refused | None:
        values = tuple(
            value if at in candidate.named else 0.0 for at, value in enumerate(candidate.values[: len(KEYS)])
        )
        return check(Candidate(values, candidate.named), state)

    return told


def _whole_arm(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse to move an arm of which a joint has no target to keep, since it was missing in the
    reading with which the robot was armed: its six joints are told at once."""
    if not candidate.values[MOVES_ARM]:
        return None
    unknown = [key for at, key in enumerate(KEYS) if key in ARM and math.isnan(candidate.values[at])]
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
    """Refuse joints of an arm that this robot has not. ``stale`` would call them silent."""
    absent = [KEYS[at] for at in candidate.named if _is_absent(at, state.observation)]
    if not absent:
        return None
    what = "claw" if absent == [CLAW] else "arm"
    return Refused(
        SpotCode.NO_ARM, f"this robot has no {what}", f"use {', '.join(BASE)}", absent[0], ", ".join(BASE)
    )


def _is_absent(at: int, observation: Observation) -> bool:
    """Whether the robot reports, and this joint is never among it."""
    return bool(observation.sensors) and math.isnan(observation.position[at]) and not observation.stamp_ns[at]


def refuse_leg(action: Mapping[str, object]) -> Refused | None:
    """Refuse to move a leg, which only the robot's own controller does."""
    for key in action:
        if isinstance(key, str) and key.removesuffix(".pos") in LEGS:
            why = f"{key}: legs belong to the locomotion controller"
            return Refused(SpotCode.READ_ONLY, why, f"walk by {', '.join(BASE)}", key, ", ".join(KEYS))
    return None


def with_parts(candidate: Candidate, state: GateState) -> Candidate:
    """Return the target with what follows from the names: which parts of the robot are told
    anything. A twist has an end; the arm holds what it was told. A joint that was never read has no
    target, and none is made up for it: in a later command it would be told that one."""
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
    """Refuse a ``set_twist`` that is no finite number, or past a limit."""
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
