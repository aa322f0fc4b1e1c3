"""Parse an action into a target, and refuse targets that robotd must not get. Pure: no I/O. No value is ever
limited silently."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import SHOWN, Axis, finite
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.velocity_base import parse_twist
from strands_actors.drivers.microduck.refusals import MicroduckCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .robots import ACTIVE, AXES, HEAD, MOUTH, POSE, TWIST, ModeLimits

DURATION = "duration"
"""Key of an action beside the axes: the duration of a twist, seconds."""

SHORTEST_S, LONGEST_S, USUAL_S = 0.1, 10.0, 1.0

MOVES, HEADS, POSES, MOUTHS, UNTIL = (len(AXES) + offset for offset in range(5))
"""Indices of the values behind a target's axes: four flags for the intents that the action names (1 or 0),
and the end of its twist, by the clock in seconds."""

INTENTS = "move (vx, vy, vyaw), head (neck_pitch ...), pose (z, roll, pitch, active), mouth (open) or do(skill=...)"

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
        reason, remedy = f"{DURATION} applies to a twist, and none is given", f"name one of {', '.join(TWIST)}"
        return Refused(Code.DURATION, reason, remedy, str(duration)[:SHOWN], ", ".join(TWIST))
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
            shown = str(targets[key])[:SHOWN]
            return Refused(
                MicroduckCode.SKILL,
                "a skill is a service, not a target",
                f"call do(skill={shown!r})",
                shown,
                "do(skill=...)",
            )
        if plain not in index:
            shown = key[:SHOWN] or "''"
            reason = f"{shown} is not a command of {robot}: robotd accepts no joint targets"
            return Refused(Code.UNKNOWN_JOINT, reason, f"use {INTENTS}", shown, ", ".join(AXES))
    return None


def _active(targets: dict[str, object]) -> Refused | None:
    """Convert the key ``active`` of an action to a number; False ends the body pose. Refuse an action that ends
    a body pose and also sets one."""
    for key in ("active", "active.pos"):
        if isinstance(targets.get(key), bool):
            targets[key] = 1.0 if targets[key] else 0.0
        value = targets.get(key)
        if key in targets and value not in (0, 1):
            shown = str(value)[:SHOWN]
            return Refused(Code.NOT_FINITE, f"active is {shown}", "give true or false", shown, "true, false")
        if value == 0 and (also := [name for name in POSE[:3] if {name, f"{name}.pos"} & targets.keys()]):
            reason = f"active=False ends the pose, and {also[0]} is given"
            return Refused(Code.BOTH, reason, "send only one of the two", also[0], "active=False alone")
    return None


def _duration(value: object) -> float | Refused:
    if value is None:
        return USUAL_S
    duration_s, limit = finite(value), f"{SHORTEST_S:g}..{LONGEST_S:g} s"
    if duration_s is not None and SHORTEST_S <= duration_s <= LONGEST_S:
        return duration_s
    shown = str(value)[:SHOWN]
    return Refused(Code.DURATION, f"{DURATION} is {shown}", f"give {limit}", shown, limit)


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
        age = f"{age_ns / 1e6:.0f} ms"
        return Refused(
            Code.STALE,
            f"no state for {age}",
            "check robotd. Commands are accepted after its next state",
            age,
            limit,
        )

    return silent


def seated(candidate: Candidate, state: GateState) -> Refused | None:
    """Return a refusal to walk if the duck sits."""
    if not candidate.values[MOVES] or not any(candidate.values[: len(TWIST)]):
        return None
    if not any(state.observation.sensors.get("sitting", ())):
        return None
    return Refused(MicroduckCode.SEATED, "the duck sits", "call stand() first", "sitting", "standing")


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
            mode_names = ", ".join(names)
            reason = "the drive mode is unknown or not supported"
            return Refused(
                Code.MODE, reason, f"call set_mode(mode=...) with one of {mode_names}", "unknown", mode_names
            )
        mode = names[number]
        limit = modes[mode]
        ahead = limit.forward if vx >= 0 else limit.backward
        for key, value, most, unit in (
            ("vx", vx, ahead, "m/s"),
            ("vy", vy, limit.side, "m/s"),
            ("vyaw", vyaw, limit.turn, "rad/s"),
        ):
            if not abs(value) <= most + _ROUNDING:
                return _over(
                    f"{key}={value:g} {unit} is over {most:g} for {mode}", f"{value:g}", f"{most:g} {unit}"
                )
        speed, most = math.hypot(vx, vy), max(ahead, limit.side)
        if speed > most + _ROUNDING:
            return _over(
                f"vx and vy are {speed:.3f} m/s, over {most:g} for {mode}", f"{speed:.3f}", f"{most:g} m/s"
            )
        return None

    return within_mode


def _over(reason: str, offered: str, limit: str) -> Refused:
    return Refused(Code.PAST_TRAVEL, reason, f"stay within {limit}", offered, limit)


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
            return Refused(code, f"the duck {word}", "put it on its feet", word, "on its feet")
    return None


def driven(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse while no policy drives the duck. robotd would accept intents, but they would have no effect."""
    reported = observation.sensors.get("driven")
    if reported is not None and reported[0]:
        return None
    return Refused(
        MicroduckCode.NOT_DRIVEN,
        "the duck holds still or is relaxed: no policy drives it",
        "call enable() first",
        "held",
        "driven",
    )


CONDITIONS = (Condition(on_its_feet), Condition(driven, on_resume=OnResume.STAY_ARMED))
