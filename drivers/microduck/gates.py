"""Parse an action into a target, and refuse targets that robotd must not get. Pure: no I/O. No value is ever
limited silently."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import Axis, finite
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.velocity_base import parse_twist
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .refusals import MicroduckCode
from .robots import ACTIVE, AXES, HEAD, MOUTH, POSE, TWIST, ModeLimits

DURATION = "duration"
"""Key of an action beside the axes: the duration of a twist, seconds."""

SHORTEST_S, LONGEST_S, USUAL_S = 0.1, 10.0, 1.0

MOVES, HEADS, POSES, MOUTHS, UNTIL = (len(AXES) + offset for offset in range(5))
"""Indices of the values behind a target's axes: four flags for the intents that the action names (1 or 0),
and the end of its twist, by the clock in seconds."""

_ROUNDING = 1e-9


def parse(
    action: Mapping[str, object], robot: str, axes: Sequence[Axis], index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Return the target of all axes, and the flags that show which parts the action commands.

    Head, pose and mouth keep their targets where the action does not name them. If it names no twist, the
    present twist continues until its duration ends.
    """
    targets = {str(key): value for key, value in action.items()}
    duration = targets.pop(DURATION, None)
    if refusal := _no_axis(targets, index, robot) or _active(targets):
        return refusal
    on_axes = msgspec.structs.replace(state, target=state.target[: len(AXES)])
    candidate = parse_twist(targets, robot, axes, index, on_axes)
    if isinstance(candidate, Refused):
        return candidate
    named = {axes[number].key for number in candidate.named}
    moves = bool(named & set(TWIST))
    until_ns = candidate.until_ns
    if moves:
        duration_s = _duration(duration)
        if isinstance(duration_s, Refused):
            return duration_s
        until_ns = state.now_ns + round(duration_s * NS)
    elif duration is not None:
        return refusals.duration_without_twist(DURATION, str(duration)[:SHOWN], ", ".join(TWIST))
    values = list(candidate.values)
    if named & set(POSE) and "active" not in named:
        values[ACTIVE] = 1.0
    flags = (float(bool(named & set(keys))) for keys in (TWIST, HEAD, POSE, MOUTH))
    return msgspec.structs.replace(candidate, values=(*values, *flags, until_ns / NS), until_ns=until_ns)


def _no_axis(targets: Mapping[str, object], index: Mapping[str, int], robot: str) -> Refused | None:
    """Refuse unknown names, which are mostly joints or skills. The refusal lists the commands to use instead."""
    for key in targets:
        plain = key.removesuffix(".pos")
        if plain == "skill":
            return refusals.skill_as_target(str(targets[key])[:SHOWN])
        if plain not in index:
            return refusals.unknown_command(key[:SHOWN] or "''", robot, ", ".join(AXES))
    return None


def _active(targets: dict[str, object]) -> Refused | None:
    """Convert the key ``active`` of an action to a number; False ends the body pose. Refuse an action that ends
    a body pose and also sets one."""
    for key in ("active", "active.pos"):
        if isinstance(targets.get(key), bool):
            targets[key] = 1.0 if targets[key] else 0.0
        value = targets.get(key)
        if key in targets and value not in (0, 1):
            return refusals.active_not_boolean(str(value)[:SHOWN])
        if value == 0 and (also := [name for name in POSE[:3] if {name, f"{name}.pos"} & targets.keys()]):
            return refusals.pose_ended_and_given(also[0])
    return None


def _duration(value: object) -> float | Refused:
    if value is None:
        return USUAL_S
    duration_s = finite(value)
    if duration_s is not None and SHORTEST_S <= duration_s <= LONGEST_S:
        return duration_s
    return refusals.bad_duration(DURATION, str(value)[:SHOWN], SHORTEST_S, LONGEST_S)


def all_gates(axes: Sequence[Axis], modes: Mapping[str, ModeLimits], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates (checks of a command) in the order in which they are applied. The first refusal is reported
    to the caller."""
    return silent(state_ttl_s), seated, within_mode(modes), past_range(axes)


def silent(ttl_s: float) -> GateCheck:
    """Return a gate that refuses commands while robotd sends no state."""
    limit = f"{ttl_s * 1e3:.0f} ms"

    def silent(candidate: Candidate, state: GateState) -> Refused | None:
        age_ns = state.now_ns - state.observation.t_ns
        if age_ns <= ttl_s * NS:
            return None
        return refusals.no_state(age_ns / 1e6, limit)

    return silent


def seated(candidate: Candidate, state: GateState) -> Refused | None:
    """Return a refusal to walk if the duck sits."""
    if not candidate.values[MOVES] or not any(candidate.values[: len(TWIST)]):
        return None
    if not any(state.observation.sensors.get("sitting", ())):
        return None
    return refusals.seated()


def within_mode(modes: Mapping[str, ModeLimits]) -> GateCheck:
    """Return a gate that refuses a twist beyond the limits of the present drive mode."""
    names = tuple(modes)

    def within_mode(candidate: Candidate, state: GateState) -> Refused | None:
        if not candidate.values[MOVES]:
            return None
        vx, vy, vyaw = candidate.values[: len(TWIST)]
        if not (vx or vy or vyaw):
            # A zero twist stops the duck in any mode.
            return None
        reported = state.observation.sensors.get("mode", (-1.0,))
        number = round(reported[0])
        if not 0 <= number < len(names):
            return refusals.unknown_mode(", ".join(names))
        mode = names[number]
        limit = modes[mode]
        ahead = limit.forward if vx >= 0 else limit.backward
        for key, value, most, unit in (
            ("vx", vx, ahead, "m/s"),
            ("vy", vy, limit.side, "m/s"),
            ("vyaw", vyaw, limit.turn, "rad/s"),
        ):
            if not abs(value) <= most + _ROUNDING:
                return refusals.past_speed_limit(key, value, unit, most, mode)
        speed, most = math.hypot(vx, vy), max(ahead, limit.side)
        if speed > most + _ROUNDING:
            return refusals.past_combined_speed_limit(speed, most, mode)
        return None

    return within_mode


# -- conditions that must be true of the robot, for any command


def on_its_feet(observation: Observation, now_ns: int) -> Refused | None:
    """Return a refusal if the duck has fallen, is limp or is held up."""
    codes = (
        (MicroduckCode.FALLEN, "has fallen"),
        (MicroduckCode.LIMP, "yields"),
        (MicroduckCode.PICKED_UP, "is held up"),
    )
    for code, word in codes:
        if any(observation.sensors.get(code, ())):
            return refusals.not_on_its_feet(code, word)
    return None


def driven(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse while no policy drives the duck. robotd would accept intents, but they would have no effect."""
    reported = observation.sensors.get("driven")
    if reported is not None and reported[0]:
        return None
    return refusals.not_driven()


CONDITIONS = (Condition(on_its_feet), Condition(driven, on_resume=OnResume.STAY_ARMED))
