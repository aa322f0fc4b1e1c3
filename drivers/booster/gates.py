"""Checks that refuse commands to a T1 in its reported state. Pure: no I/O.

A condition must be true of the robot before any command is accepted. A gate checks one command.
The arguments of services are checked here, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import SHOWN, finite
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.booster.refusals import BoosterCode
from strands_actors.drivers.common.kit.motor_targets import target_gates
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .config import CONTROL_S
from .protocol import Fall
from .robots import BASE, HEAD, LAST_ARM, Model
from .rpc import WALKS, Mode

STATE_TTL_S = 0.1
"""Age up to which a LowState counts [assumed]. 50 of them arrive in that time."""
FALL_TTL_S = 1.0
"""Age up to which the fall state permits a command [assumed]. The robot sends it at least twice a
second."""
FALL_LOST_S = 3.0
"""Age of the fall state that ends a motion. A working robot sends it twice a second, so it is not
silent for so long."""

MODE_TTL_S = 1.0
"""Age at which the mode counts as unknown, because the legs may obey our frames by then. It is five
unanswered requests, and twice the time that an answer may take. Without any answer for so long, the
link counts as lost, too."""

MODES = {mode.name.lower(): mode for mode in (Mode.DAMPING, Mode.PREPARE, Mode.WALKING, Mode.SOCCER)}
"""The modes that ``change_mode`` accepts. Custom mode is missing: there every motor, the legs too,
obeys LowCmd."""


# -- conditions that must be true of the robot, for any command


def conditions() -> tuple[Condition, ...]:
    """Return the conditions (checks of the robot's state that must pass while it is commanded), in
    the order in which they are checked.

    When a condition becomes false, the robot's own controller gets the upper body back at once. This
    controller needs the arms when the robot falls or gets up.
    """
    return (
        Condition(ready, Reason.FAULT, SafeState.STOP, always=True),
        Condition(mode_reported, Reason.FAULT, SafeState.STOP, always=True),
        Condition(not_custom, Reason.FAULT, SafeState.STOP, always=True),
    )


def ready(observation: Observation, now_ns: int) -> Refused | None:
    return not_ready(observation, now_ns, FALL_LOST_S)


def not_ready(observation: Observation, now_ns: int, ttl_s: float) -> Refused | None:
    reported = observation.sensors.get("fall_state")
    if reported is None:
        return Refused(
            BoosterCode.FALL_UNKNOWN,
            "the robot has not reported its fall state",
            "check the robot's fall_down topic",
        )
    number, read_s = reported
    age_s = now_ns / NS - read_s
    if age_s > ttl_s:
        age, limit = f"{age_s:.1f} s", f"{ttl_s:.1f} s"
        reason = f"the last report of the fall state is {age} old (limit {limit})"
        return Refused(BoosterCode.FALL_STALE, reason, "check the robot and the network", age, limit)
    if number == Fall.IS_READY:
        return None
    name = Fall(int(number)).name
    reason = f"the robot reports {name}"
    return Refused(
        BoosterCode.FALLEN, reason, "wait until the robot has got up (IS_READY)", name, Fall.IS_READY.name
    )


def mode_reported(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse commands while the mode is unknown: the robot has not reported it lately, or has
    answered with an error."""
    reported = observation.sensors.get("mode")
    if reported is None:
        return Refused(
            Code.MODE_UNKNOWN, "the robot does not report the mode", "check that the robot's service runs"
        )
    _, read_s = reported
    age_s = now_ns / NS - read_s
    if age_s <= MODE_TTL_S:
        return None
    age, limit = f"{age_s:.1f} s", f"{MODE_TTL_S:.1f} s"
    reason = f"the last report of the mode is {age} old (limit {limit})"
    return Refused(Code.MODE_STALE, reason, "check the robot and the network", age, limit)


def not_custom(observation: Observation, now_ns: int) -> Refused | None:
    if mode_in(observation) is not Mode.CUSTOM:
        return None
    reason = "in custom mode this program commands every motor, and the legs would lose their torque"
    return Refused(
        BoosterCode.CUSTOM_MODE,
        reason,
        "switch it to walking mode with its remote control",
        "custom",
        ", ".join(MODES),
    )


def mode_in(observation: Observation) -> Mode | None:
    """Return the mode that the robot reported; None if it is unknown."""
    reported = observation.sensors.get("mode")
    return None if reported is None else Mode(int(reported[0]))


# -- gates: each checks one command


def gates(model: Model) -> tuple[GateCheck, ...]:
    return (_state_fresh, _ready_lately, _enough_motors, _handed_over, *target_gates(model, CONTROL_S))


def _state_fresh(candidate: Candidate, state: GateState) -> Refused | None:
    stamp_ns = state.observation.t_ns
    if stamp_ns == 0:
        reason = "no state has arrived yet (topic LowState)"
        return Refused(Code.NO_STATE, reason, "wait for the first state, or check the network")
    age_ns = state.now_ns - stamp_ns
    if age_ns <= STATE_TTL_S * NS:
        return None
    age, limit = f"{age_ns / 1e6:.0f} ms", f"{STATE_TTL_S * 1e3:.0f} ms"
    reason = f"last LowState is {age} old (limit {limit})"
    return Refused(Code.STALE, reason, "check the robot and the network", age, limit)


def _ready_lately(candidate: Candidate, state: GateState) -> Refused | None:
    return not_ready(state.observation, state.now_ns, FALL_TTL_S)


def _enough_motors(candidate: Candidate, state: GateState) -> Refused | None:
    (count,) = state.observation.sensors.get("motors", (0.0,))
    if count > LAST_ARM:
        return None
    reason = f"the robot reports {count:.0f} motors, fewer than a T1 has"
    limit = f"more than {LAST_ARM}"
    return Refused(BoosterCode.TOO_FEW_MOTORS, reason, "check that it is a T1", f"{count:.0f}", limit)


def _handed_over(candidate: Candidate, state: GateState) -> Refused | None:
    (host_has_arms,) = state.observation.sensors.get("upper_body", (0.0,))
    if host_has_arms:
        return None
    reason = "the onboard controller still has the upper body"
    return Refused(BoosterCode.UPPER_BODY, reason, "call enable_upper_body() first")


def refuse_others(model: Model, action: Mapping[Any, object]) -> Refused | None:
    """Refuse motors that only the robot's own controller may drive, and base speeds (``vx`` ...)
    given as joints."""
    keys = ", ".join(joint.key for joint in model.joints)
    for key in action:
        name = str(key).removesuffix(".pos")
        motor = next((motor for motor in model.motors if motor.key == name and motor not in model.joints), None)
        if motor is not None:
            reason = f"{name} (slot {motor.slot}) is moved only by the onboard controller"
            remedy = "call rotate_head(pitch, yaw)" if name in HEAD.values() else f"commandable: {keys}"
            return Refused(BoosterCode.NOT_OURS, reason, remedy, name, keys)
        if name in BASE:
            return Refused(
                BoosterCode.NOT_A_JOINT,
                f"{name} is a speed of the base, not a joint",
                "call move(vx, vy, vyaw)",
                name,
                keys,
            )
    return None


# -- services


def refuse_arguments(model: Model, service: str, arguments: Mapping[str, Any]) -> Refused | None:
    """Refuse an argument that is not a number or is outside its limits, and an unknown mode."""
    limits: dict[str, tuple[float, float, str]] = {}
    match service:
        case "move":
            units = ("m/s", "m/s", "rad/s")
            limits = {name: (-most, most, unit) for name, most, unit in zip(BASE, model.twist, units, strict=True)}
        case "rotate_head":
            limits = {name: (*model.limits(joint), "rad") for name, joint in HEAD.items()}
        case "change_mode":
            return _refuse_mode(arguments)
        case "enable_upper_body" if not isinstance(on := arguments.get("on", True), bool):
            # Refuse any type but ``bool``: the text "no" would count as true.
            shown = str(on)[:SHOWN]
            reason = f"on is {shown!r}"
            return Refused(Code.BAD_ARGUMENT, reason, "give True or False", shown, "True or False")
    for name, (low, high, unit) in limits.items():
        value, shown = finite(arguments.get(name, 0.0)), str(arguments.get(name))[:SHOWN]
        if value is None:
            reason = f"{name} is {shown}"
            return Refused(Code.NOT_FINITE, reason, "give a finite number", shown, "a finite number")
        if not low <= value <= high:
            limit = f"{low:g}..{high:g} {unit}"
            reason = f"{name}={value:.4g} is outside {limit}"
            return Refused(Code.PAST_LIMIT, reason, "give a value within this range", f"{value:.4g}", limit)
    return None


def _refuse_mode(arguments: Mapping[str, Any]) -> Refused | None:
    mode = arguments.get("mode")
    if mode in MODES:
        return None
    names, shown = ", ".join(MODES), str(mode)[:SHOWN]
    return Refused(BoosterCode.UNKNOWN_MODE, f"mode is {shown!r}", f"use one of {names}", shown, names)


def move_refusal(mode: Mode | None) -> Refused | None:
    if mode in WALKS:
        return None
    name = "unknown" if mode is None else mode.name.lower()
    remedy = "call change_mode('walking') first"
    return Refused(Code.MODE, f"the robot does not walk in {name} mode", remedy, name, _names(WALKS))


def handover_refusal(mode: Mode | None, modes: Sequence[Mode]) -> Refused | None:
    if mode in modes:
        return None
    name = "unknown" if mode is None else mode.name.lower()
    reason = f"in {name} mode no controller balances the robot"
    return Refused(Code.MODE, reason, "call change_mode('walking') first", name, _names(modes))


def _names(modes: Sequence[Mode]) -> str:
    return ", ".join(mode.name.lower() for mode in modes)
