"""The gates in front of a user's class: names and numbers, silence of the robot, and the class's limits.
Pure. A refusal by the class itself comes afterwards, as its answer."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, too_fast
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.plain.refusals import PlainCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

REFUSED = "send_action: "
"""Prefix of a fault that is the class's own answer to an action."""


def all_gates(axes: Sequence[Axis], state_ttl_s: float, longest_s: float) -> tuple[GateCheck, ...]:
    return not_heard(axes, state_ttl_s), past_range(axes), _too_fast(axes, longest_s)


def not_heard(axes: Sequence[Axis], ttl_s: float) -> GateCheck:
    """Refuse to move an axis without a reading within ``ttl_s``. An axis that the class has never measured
    counts as read with the newest observation."""
    ttl_ns = round(ttl_s * NS)
    limit = f"{ttl_s * 1e3:.0f} ms"
    remedy = "check the robot's cable and power: it is back by itself as soon as it answers"

    def not_heard(candidate: Candidate, state: GateState) -> Refused | None:
        seen = state.observation
        for at in candidate.named:
            read_ns = seen.stamp_ns[at] or seen.t_ns
            age_ms = (state.now_ns - read_ns) / 1e6
            if state.now_ns - read_ns > ttl_ns:
                age = f"for {age_ms:.0f} ms"
                return Refused(Code.STALE, f"no reading of {axes[at].key} {age}", remedy, age, limit)
        return None

    return not_heard


def _too_fast(axes: Sequence[Axis], longest_s: float) -> GateCheck:
    check = too_fast(axes, longest_s=longest_s)
    limited = {at for at, axis in enumerate(axes) if math.isfinite(axis.speed)}

    def only_limited(candidate: Candidate, state: GateState) -> Refused | None:
        named = tuple(at for at in candidate.named if at in limited)
        return check(msgspec.structs.replace(candidate, named=named), state) if named else None

    return only_limited


def _refused_by_the_class(observation: Observation, now_ns: int) -> Refused | None:
    for axis, fault in observation.faults.items():
        if fault.startswith(REFUSED):
            why = fault.removeprefix(REFUSED)
            return Refused(PlainCode.REFUSED_BY_DRIVER, f"{axis}: {why}", "call resume()", why)
    return None


CONDITIONS = (Condition(_refused_by_the_class, Reason.FAULT, on_resume=OnResume.ARM_ANEW),)
"""A class that has refused an action gets no further action: the robot is stopped, and its status has the
reason."""
