"""Conditions and gates that refuse a setpoint before it reaches the base. Pure; nothing is ever clipped."""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.drivers.kinova.refusals import KinovaCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from . import speeds
from .protocol import ArmState, arm_state_name

BASE = "base"
"""Key of ``Observation.faults`` for the reason why the wire no longer sends speeds."""

_ROUNDING = 1e-9


def all_gates(axes: Sequence[Axis], state_ttl_s: float, period_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order of their checks. The first that refuses gives the answer."""
    return stale(axes, state_ttl_s), past_range(axes), too_fast(axes, period_s)


def needed_speeds(target: Sequence[float], state: GateState, period_s: float) -> tuple[float, ...]:
    """Return the speeds that take the arm from its present position to ``target`` in one period."""
    seen = state.observation
    velocity = seen.velocity or (0.0,) * len(seen.position)
    now = speeds.position_now(seen.position, velocity, (state.now_ns - seen.t_ns) / NS)
    return speeds.needed(target, now, period_s)


def too_fast(axes: Sequence[Axis], period_s: float) -> GateCheck:
    """Refuse a target that is further from the measured position than a joint may turn in one control
    period.

    This also holds for a stream: if the arm falls behind its stream, it must not chase it.
    """

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        for at in candidate.named:
            axis, speed = axes[at], abs(candidate.values[len(axes) + at])
            if not speed <= axis.speed + _ROUNDING:
                most = math.floor(axis.speed * period_s * 1e5) / 1e5
                return Refused(
                    Code.TOO_FAST,
                    f"{axis.key} needs {speed:.4g} rad/s to be there within {period_s * 1e3:.3g} ms",
                    f"step at most {most:.5f} rad from the measured position",
                    f"{speed:.4g}",
                    f"{axis.speed:.4g}",
                )
        return None

    return too_fast


def refuse_state(state: int, fault_bank: int) -> Refused | None:
    """Refuse a base that would not move its arm. Arming makes the same check."""
    if state == ArmState.SERVOING_READY:
        return None
    name, required = arm_state_name(state), arm_state_name(ArmState.SERVOING_READY)
    if state == ArmState.IN_FAULT:
        why = f"base in fault (bank 0x{fault_bank:x})"
        return Refused(KinovaCode.BASE_IN_FAULT, why, "clear it, then reconnect", name, required)
    return Refused(
        KinovaCode.ARM_STATE, f"the arm is {name}", "make it ready on the base's own page", name, required
    )


def base_ready(observation: Observation, now_ns: int) -> Refused | None:
    state, bank = (number_of(observation.sensors, name, 0) for name in ("arm_state", "fault_bank"))
    return refuse_state(state, bank)


def commanded(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse after the wire has stopped the arm by itself, or the base has refused its speeds. Motion does
    not continue by itself after that."""
    why = observation.faults.get(BASE)
    return None if why is None else Refused(KinovaCode.STOPPED, why, "call resume()", why)


CONDITIONS = (
    Condition(base_ready, always=True),
    Condition(commanded, always=True, on_resume=OnResume.ARM_ANEW),
)
