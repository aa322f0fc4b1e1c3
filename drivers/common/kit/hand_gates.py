"""Gates and observations of an arm with a hand, the last of its axes (``hand``). Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from msgspec import structs

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import refusals
from .hand import AXIS

HAND_TTL_S = 0.5
"""A reading of the hand may be this old. Hands are read more slowly than arms."""
CONTACT = "gripper_contact"
"""The sensor that shows whether the hand holds something."""
STEP_S = 0.1
"""In a stream, a target may be as far from the last one as the hand moves in this time. A hand limits its own
speed, so a late target that is followed by an early one does no harm."""


def gates_with_hand(arm: Sequence[GateCheck], axes: Sequence[Axis]) -> tuple[GateCheck, ...]:
    """Return the gates of an arm that has a hand.

    Args:
        arm: The gates of the arm alone.
        axes: The axes of the arm, and then that of the hand.
    """
    hand: Sequence[GateCheck] = (
        no_fault,
        stale(axes, HAND_TTL_S),
        past_range(axes),
        _too_fast(axes),
    )
    last = len(axes) - 1
    return *(_for_arm(gate, last) for gate in arm), *(_for_hand(gate, last) for gate in hand)


def _too_fast(axes: Sequence[Axis]) -> GateCheck:
    """Refuse a step in a stream that is longer than the hand moves in ``STEP_S``, however fast the stream is."""
    step = too_fast(axes, longest_s=STEP_S)

    def too_fast_for_hand(candidate: Candidate, state: GateState) -> Refused | None:
        return step(candidate, structs.replace(state, period_s=STEP_S))

    return too_fast_for_hand


def no_fault(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse to move a hand that is lost or reports a fault. The arm still takes commands."""
    fault = state.observation.faults.get(AXIS)
    return None if fault is None else refusals.hand_fault(AXIS, fault)


def _for_arm(gate: GateCheck, count: int) -> GateCheck:
    """Return a gate of the first ``count`` axes as a gate of all axes."""

    def for_arm(candidate: Candidate, state: GateState) -> Refused | None:
        named = tuple(index for index in candidate.named if index < count)
        extras = candidate.values[count + 3 :]
        return gate(structs.replace(candidate, values=candidate.values[:count] + extras, named=named), state)

    return for_arm


def _for_hand(gate: GateCheck, last: int) -> GateCheck:
    """Return a gate that is asked only about the axis ``last``, if an action names it."""

    def for_hand(candidate: Candidate, state: GateState) -> Refused | None:
        return gate(structs.replace(candidate, named=(last,)), state) if last in candidate.named else None

    return for_hand


class Hand(Protocol):
    """What an observation needs to know of a hand."""

    @property
    def opening(self) -> float: ...  # percent
    @property
    def stamp_ns(self) -> int: ...  # time of the reading
    @property
    def contact(self) -> float: ...  # 1 if it holds something, 0 if not, not a number if that is unknown
    @property
    def fault(self) -> str: ...  # empty for none


def with_hand(observation: Observation, hand: Hand) -> Observation:
    """Return the observation of an arm with the reading of its hand as the last axis."""
    velocity = observation.velocity
    return structs.replace(
        observation,
        position=(*observation.position, hand.opening),
        stamp_ns=(*observation.stamp_ns, hand.stamp_ns),
        velocity=(*velocity, 0.0) if velocity else (),
        sensors={**observation.sensors, CONTACT: (hand.contact,)},
        faults={**observation.faults, AXIS: hand.fault} if hand.fault else observation.faults,
    )


__all__ = ["CONTACT", "HAND_TTL_S", "Hand", "gates_with_hand", "with_hand"]
