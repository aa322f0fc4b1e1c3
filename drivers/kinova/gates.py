"""Conditions and gates: pure functions that refuse a setpoint before it reaches the base.

They never change (clip) a value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals, speeds
from .protocol import ArmState, arm_state_name

BASE = "base"
"""Key of ``Observation.faults`` for the reason why the driver no longer sends speeds."""

_ROUNDING = 1e-9


def all_gates(axes: Sequence[Axis], state_ttl_s: float, period_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they check a setpoint. The first refusal is reported."""
    return stale(axes, state_ttl_s), past_range(axes), too_fast(axes, period_s)


def needed_speeds(target: Sequence[float], state: GateState, period_s: float) -> tuple[float, ...]:
    """Return the speeds (rad/s) that move the arm from its present position to ``target`` in one control period."""
    observation, joints = state.observation, len(target)
    velocity = observation.velocity[:joints] or (0.0,) * joints
    now = speeds.position_now(observation.position[:joints], velocity, (state.now_ns - observation.t_ns) / NS)
    return speeds.needed(target, now, period_s)


def too_fast(axes: Sequence[Axis], period_s: float) -> GateCheck:
    """Refuse a target that a joint cannot reach from its measured position within one control period.

    A stream of targets is checked in the same way. If the arm lags too far behind the stream, the next target is
    refused, so that the arm never speeds up to catch up.
    """

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        for index in candidate.named:
            axis, speed = axes[index], abs(candidate.values[len(axes) + index])
            if not speed <= axis.speed + _ROUNDING:
                most = math.floor(axis.speed * period_s * 1e5) / 1e5
                target = None if state.stream else candidate.values[index]
                return refusals.too_fast(axis.key, speed, period_s * 1e3, most, axis.speed, target)
        return None

    return too_fast


def refuse_state(state: int, fault_bank: int) -> Refused | None:
    """Return a refusal if the base (the arm's controller) is in a state in which it does not move the arm. Arming
    makes the same check."""
    if state == ArmState.SERVOING_READY:
        return None
    name, required = arm_state_name(state), arm_state_name(ArmState.SERVOING_READY)
    if state == ArmState.IN_FAULT:
        return refusals.base_in_fault(fault_bank, name, required)
    return refusals.arm_not_ready(name, required)


def single_level(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse every setpoint while another client has the base in low-level servoing. It then refuses speeds. Arming
    sets single-level servoing again."""
    state = number_of(observation.sensors, "arm_state", 0)
    return refusals.low_level_servoing(arm_state_name(state)) if state == ArmState.LOW_LEVEL_SERVOING else None


def base_ready(observation: Observation, now_ns: int) -> Refused | None:
    state, bank = (number_of(observation.sensors, name, 0) for name in ("arm_state", "fault_bank"))
    return None if state == ArmState.LOW_LEVEL_SERVOING else refuse_state(state, bank)


def commanded(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse every setpoint after the driver has stopped the arm by itself, or the base has refused its speeds.

    The arm moves again only after the caller has called ``resume()``.
    """
    reason = observation.faults.get(BASE)
    return None if reason is None else refusals.stopped(reason)


CONDITIONS = (
    Condition(base_ready, always=True),
    Condition(single_level, always=True, on_resume=OnResume.ARM_ANEW),
    Condition(commanded, always=True, on_resume=OnResume.ARM_ANEW),
)
