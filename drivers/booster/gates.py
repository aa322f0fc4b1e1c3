"""Checks that refuse commands to a T1 in its reported state. Pure: no I/O.

A condition must be true of the robot before any command is accepted. A gate checks one command.
The arguments of services are checked here, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, Reason
from strands_actors.contract.refusals import bad_argument
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.motor_targets import target_gates
from strands_actors.drivers.common.kit.refusals import stale_low_state
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
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
        return refusals.unknown_fall_state()
    number, read_s = reported
    age_s = now_ns / NS - read_s
    if age_s > ttl_s:
        return refusals.stale_fall_state(age_s, ttl_s)
    if number == Fall.IS_READY:
        return None
    return refusals.fallen(Fall(int(number)).name)


def mode_reported(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse commands while the mode is unknown: the robot has not reported it lately, or has
    answered with an error."""
    reported = observation.sensors.get("mode")
    if reported is None:
        return refusals.unreported_mode()
    _, read_s = reported
    age_s = now_ns / NS - read_s
    if age_s <= MODE_TTL_S:
        return None
    return refusals.stale_mode(age_s, MODE_TTL_S)


def not_custom(observation: Observation, now_ns: int) -> Refused | None:
    if mode_in(observation) is not Mode.CUSTOM:
        return None
    return refusals.custom_mode(", ".join(MODES))


def mode_in(observation: Observation) -> Mode | None:
    """Return the mode that the robot reported; None if it is unknown."""
    reported = observation.sensors.get("mode")
    return None if reported is None else Mode(int(reported[0]))


# -- gates: each checks one command


def gates(model: Model) -> tuple[GateCheck, ...]:
    return (
        _state_fresh,
        _ready_lately,
        _enough_motors,
        _handed_over,
        *target_gates(model, CONTROL_S, plans_motion=True),
    )


def _state_fresh(candidate: Candidate, state: GateState) -> Refused | None:
    stamp_ns = state.observation.t_ns
    if stamp_ns == 0:
        return refusals.no_state()
    age_ns = state.now_ns - stamp_ns
    if age_ns <= STATE_TTL_S * NS:
        return None
    return stale_low_state(age_ns / 1e6, STATE_TTL_S * 1e3)


def _ready_lately(candidate: Candidate, state: GateState) -> Refused | None:
    return not_ready(state.observation, state.now_ns, FALL_TTL_S)


def _enough_motors(candidate: Candidate, state: GateState) -> Refused | None:
    (count,) = state.observation.sensors.get("motors", (0.0,))
    if count > LAST_ARM:
        return None
    return refusals.too_few_motors(count, LAST_ARM)


def _handed_over(candidate: Candidate, state: GateState) -> Refused | None:
    (host_has_arms,) = state.observation.sensors.get("upper_body", (0.0,))
    if host_has_arms:
        return None
    return refusals.upper_body_not_handed_over()


def refuse_others(model: Model, action: Mapping[Any, object]) -> Refused | None:
    """Refuse motors that only the robot's own controller may drive, and base speeds (``vx`` ...)
    given as joints."""
    keys = ", ".join(joint.key for joint in model.joints)
    for key in action:
        name = str(key).removesuffix(".pos")
        motor = next((motor for motor in model.motors if motor.key == name and motor not in model.joints), None)
        if motor is not None:
            return refusals.onboard_joint(name, motor.slot, keys, is_head=name in HEAD.values())
        if name in BASE:
            return refusals.base_speed(name, keys)
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
            return bad_argument("on", on, "True or False")
    for name, (low, high, unit) in limits.items():
        value, shown = finite(arguments.get(name, 0.0)), str(arguments.get(name))[:SHOWN]
        if value is None:
            return refusals.argument_not_finite(name, shown)
        if not low <= value <= high:
            return refusals.argument_past_limit(name, value, f"{low:g}..{high:g} {unit}")
    return None


def _refuse_mode(arguments: Mapping[str, Any]) -> Refused | None:
    mode = arguments.get("mode")
    if mode in MODES:
        return None
    return refusals.unknown_mode(str(mode)[:SHOWN], ", ".join(MODES))


def move_refusal(mode: Mode | None) -> Refused | None:
    if mode in WALKS:
        return None
    return refusals.mode_without_walking(_name(mode), _names(WALKS))


def handover_refusal(mode: Mode | None, modes: Sequence[Mode]) -> Refused | None:
    if mode in modes:
        return None
    return refusals.mode_without_balance(_name(mode), _names(modes))


def _name(mode: Mode | None) -> str:
    return "unknown" if mode is None else mode.name.lower()


def _names(modes: Sequence[Mode]) -> str:
    return ", ".join(map(_name, modes))
