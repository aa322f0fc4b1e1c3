"""Gates that check an action before the user's class gets it: the names, the numbers, the age of the last reading,
and the limits that the class declares. Pure. If the class itself refuses the action later, the gate stops the
robot."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, too_fast
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals

REFUSED = "send_action: "
"""Prefix of a fault text that the class returned for an action."""


def all_gates(axes: Sequence[Axis], state_ttl_s: float, longest_s: float) -> tuple[GateCheck, ...]:
    return refuse_stale_axes(axes, state_ttl_s), past_range(axes), _too_fast(axes, longest_s)


def refuse_stale_axes(axes: Sequence[Axis], ttl_s: float) -> GateCheck:
    """Refuse to move an axis whose last reading is older than ``ttl_s``. For an axis that the class has never
    measured, the age of the newest observation counts."""
    ttl_ns = round(ttl_s * NS)

    def refuse_stale_axes(candidate: Candidate, state: GateState) -> Refused | None:
        observation = state.observation
        for index in candidate.named:
            read_ns = observation.stamp_ns[index] or observation.t_ns
            age_ms = (state.now_ns - read_ns) / 1e6
            if state.now_ns - read_ns > ttl_ns:
                return refusals.stale_axis(axes[index].key, age_ms, ttl_s * 1e3)
        return None

    return refuse_stale_axes


def _too_fast(axes: Sequence[Axis], longest_s: float) -> GateCheck:
    check = too_fast(axes, longest_s=longest_s)
    limited = {index for index, axis in enumerate(axes) if math.isfinite(axis.speed)}

    def only_limited(candidate: Candidate, state: GateState) -> Refused | None:
        named = tuple(index for index in candidate.named if index in limited)
        return check(msgspec.structs.replace(candidate, named=named), state) if named else None

    return only_limited


def _refused_by_the_class(observation: Observation, now_ns: int) -> Refused | None:
    for axis, fault in observation.faults.items():
        if fault.startswith(REFUSED):
            return refusals.rejected_by_class(axis, fault.removeprefix(REFUSED))
    return None


CONDITIONS = (Condition(_refused_by_the_class, Reason.FAULT, on_resume=OnResume.ARM_ANEW),)
"""A class that has refused an action gets no further action: the robot is stopped, and its status has the
reason."""
