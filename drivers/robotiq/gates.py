"""What is refused before it reaches the gripper. Every gate is a pure function; nothing is ever clipped."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from .protocol import MAJOR, NO_FAULT, OVER_TEMPERATURE, RELEASING, SILENCE, Activation, fault_words

POSITION, SPEED, FORCE = range(3)
"""What a target is made of. All are fractions: 0 open .. 1 closed, 0 slowest .. 1 fastest, 0 weakest .. 1
strongest."""

DEFAULTS = (math.nan, 1.0, 1.0)

_ROUNDING = 1e-9


class Key(msgspec.Struct, frozen=True):
    """One key of an action. ``value = zero + scale * number``."""

    slot: int
    high: float = 1.0
    unit: str = ""
    zero: float = 0.0
    scale: float = 1.0

    def refuse(self, name: str, number: float) -> Refused | None:
        # not (a <= b) rather than b < a: a NaN is refused too
        if 0.0 <= number <= self.high + _ROUNDING:
            return None
        unit = f" {self.unit}" if self.unit else ""
        end = 0.0 if number < 0.0 else self.high
        limit = f"0..{self.high:g}{unit}"
        return Refused(
            "past_travel",
            f"move: {name} {number:g}{unit} is past {end:g}",
            f"stay within {limit}",
            f"{number:g}",
            limit,
        )


def keys_of(stroke_mm: float) -> Mapping[str, Key]:
    """The keys of an action: how far closed, or how wide open, and how."""
    closed = Key(POSITION)
    opening = Key(POSITION, stroke_mm, "mm", 1.0, -1.0 / stroke_mm)
    return {
        "gripper": closed,
        "gripper.pos": closed,
        "position": opening,
        "aperture_mm": opening,
        "speed": Key(SPEED),
        "force": Key(FORCE),
    }


def position_key(action: Mapping[str, object], keys: Mapping[str, Key]) -> str:
    """The key of an accepted action that says where to go."""
    return next(name for name in action if keys[name].slot == POSITION)


def parse(action: Mapping[str, object], robot: str, keys: Mapping[str, Key]) -> Candidate | Refused:
    """Names and numbers to a whole target. Exactly one key says where to go."""
    names = ", ".join(keys)
    positions = ", ".join(name for name, key in keys.items() if key.slot == POSITION)
    target = list(DEFAULTS)
    given: dict[int, str] = {}
    for name, value in action.items():
        key = keys.get(name) if isinstance(name, str) else None
        if key is None:
            shown = str(name)[:40] or "''"
            return Refused("unknown_joint", f"move: {shown} is not a key of {robot}", f"use {names}", shown, names)
        if key.slot in given:
            both = f"{given[key.slot]} and {name}"
            return Refused("both_spellings", f"move: {both} are both given", "send one of them", both, positions)
        number = finite(value)
        if number is None:
            shown = str(value)[:40]
            return Refused(
                "not_finite", f"move: {name} is {shown}", "send a finite number", shown, "a finite number"
            )
        refusal = key.refuse(name, number)
        if refusal is not None:
            return refusal
        given[key.slot] = name
        target[key.slot] = min(1.0, max(0.0, key.zero + key.scale * number))  # the rounding of the check
    if POSITION not in given:
        said = ", ".join(given.values()) or "{}"
        return Refused(
            "empty", "move: the action says no position", f"use one of {positions}", offered=said, limit=positions
        )
    return Candidate(tuple(target), (POSITION,))


def all_gates(state_ttl_s: float) -> tuple[GateCheck, ...]:
    """In the order in which they are asked: the first that refuses answers."""
    return stale(state_ttl_s), activated, fault_free


def stale(ttl_s: float) -> GateCheck:
    def stale(candidate: Candidate, state: GateState) -> Refused | None:
        age_ns = state.now_ns - state.observation.stamp_ns[0]
        if age_ns <= ttl_s * NS:
            return None
        age, limit = f"{age_ns / 1e6:.0f} ms", f"{ttl_s * 1e3:.0f} ms"
        return Refused(
            "stale",
            f"move: nothing was heard of the gripper for {age}",
            "check its cable and power: it is back by itself as soon as it answers",
            age,
            limit,
        )

    return stale


def activated(candidate: Candidate, state: GateState) -> Refused | None:
    activation = round(state.observation.sensors["activation"][0])
    if activation == Activation.ACTIVE:
        return None
    return Refused(
        "not_activated",
        f"move: the gripper is not activated (gSTA {activation})",
        "call stop(), then resume(): it activates, moving its fingers through their whole stroke",
        str(activation),
        str(int(Activation.ACTIVE)),
    )


def fault_free(candidate: Candidate, state: GateState) -> Refused | None:
    fault = round(state.observation.sensors["fault"][0])
    if fault in (NO_FAULT, SILENCE):
        return None
    if fault == RELEASING:
        remedy = "wait until it has ended, then call stop() and resume()"
    elif fault == OVER_TEMPERATURE:
        remedy = "let it cool"
    elif fault >= MAJOR:
        remedy = "see to its cause, then call stop() and resume(): it activates through its whole stroke"
    else:
        remedy = "call stop(), then resume()"
    return Refused("fault", f"move: the gripper reports {fault_words(fault)}", remedy, str(fault), "0")
